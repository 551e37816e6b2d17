"""Heights as GeoTIFF (OGC 19-008r4): band 1 the height, band 2 its uncertainty, metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.errors import OutputError
from insonify.extras import optional
from insonify.io.datum import Datum
from insonify.io.maps.heights import height_grid
from insonify.mapping.voxels import VoxelMap

_BANDS = """<GDALMetadata>
<Item name="DESCRIPTION" sample="0" role="description">height, m</Item>
<Item name="DESCRIPTION" sample="1" role="description">uncertainty (1 sigma), m</Item>
</GDALMetadata>"""
_ASCII, _SHORT, _DOUBLE = 2, 3, 12


def save_geotiff(
    voxels: VoxelMap, path: Path, datum: Datum | None = None, epsg: int | None = None
) -> None:
    """Write the heights of a map.

    Without a datum the file has the world's x and y, and no reference system unless ``epsg`` is
    the code of one that they are of, as 32632 of UTM 32 N.  With one they are a
    transverse Mercator projection about the datum, scale 1: within a centimetre of the local
    plane up to 10 km away, at the datum's height.

    Raises:
        OutputError: No voxel is occupied, or a map with an origin is given a datum.
        MissingExtraError: The package tifffile is not installed.
    """
    if datum is not None and any(voxels.origin_m):
        raise OutputError(
            f"{path.name}: the map has an origin at {voxels.origin_m} m, so its coordinates are of "
            "a system of their own; say which (--epsg) instead of a datum"
        )
    tifffile = optional("tifffile", "maps", "a GeoTIFF")
    grid = height_grid(voxels, path)
    scale = (grid.cell_m, grid.cell_m, 0.0)
    corner = (0.0, 0.0, 0.0, grid.west_m, grid.north_m, 0.0)
    tags = [
        (33550, _DOUBLE, 3, scale, True),
        (33922, _DOUBLE, 6, corner, True),
        (42112, _ASCII, len(_BANDS) + 1, _BANDS, True),
        (42113, _ASCII, 4, "nan", True),
    ]
    tifffile.imwrite(
        path,
        np.stack([grid.height_m, grid.uncertainty_m]),
        photometric="minisblack",
        planarconfig="separate",
        compression="zlib",
        metadata=None,
        software="insonify",
        extratags=tags
        + (_projection(datum) if datum is not None else [])
        + (_registered(epsg) if epsg is not None else []),
    )


def _projection(datum: Datum) -> list[tuple[int, int, int, object, bool]]:
    """The GeoTIFF keys of a transverse Mercator projection on WGS 84."""
    doubles = (datum.longitude_deg, datum.latitude_deg, 0.0, 0.0, 1.0)
    short = {1024: 1, 1025: 1, 2048: 4326, 3072: 32767, 3074: 32767, 3075: 1, 3076: 9001}
    keys = [(key, 0, 1, value) for key, value in short.items()]
    numbers = (3080, 3081, 3082, 3083, 3092)
    keys += [(key, 34736, 1, place) for place, key in enumerate(numbers)]
    directory = (1, 1, 0, len(keys), *(value for key in sorted(keys) for value in key))
    return [
        (34735, _SHORT, len(directory), directory, True),
        (34736, _DOUBLE, len(doubles), doubles, True),
    ]


def _registered(epsg: int) -> list[tuple[int, int, int, object, bool]]:
    """The GeoTIFF keys of a projected system of the EPSG's register."""
    directory = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, epsg)
    return [(34735, _SHORT, len(directory), directory, True)]
