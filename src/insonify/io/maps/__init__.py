"""Voxel maps as files, the format chosen by the suffix; docs/maps.md says what each keeps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from insonify.errors import MapFileError, OutputError
from insonify.io.datum import Datum
from insonify.io.maps.blocks import cropped
from insonify.io.maps.chunks import load_zarr, save_zarr
from insonify.io.maps.geotiff import save_geotiff
from insonify.io.maps.heights import save_xyz
from insonify.io.maps.native import load_npz, save_npz
from insonify.io.maps.octomap import load_octomap, save_octomap
from insonify.io.maps.pointcloud import save_point_cloud
from insonify.io.maps.surface import save_surface
from insonify.io.maps.vdb import save_vdb
from insonify.mapping.voxels import VoxelMap
from insonify.types import Box

__all__ = ["LOADED", "SAVED", "load_map", "save_map", "save_point_cloud"]

LOADED = (".npz", ".zarr", ".ot", ".bt")
_SAVERS: dict[str, Callable[[VoxelMap, Path], None]] = {
    ".npz": save_npz,
    ".zarr": save_zarr,
    ".ot": save_octomap,
    ".bt": save_octomap,
    ".ply": save_point_cloud,
    ".glb": save_surface,
    ".stl": save_surface,
    ".tif": save_geotiff,
    ".xyz": save_xyz,
    ".vdb": save_vdb,
}
SAVED = tuple(_SAVERS)


def save_map(
    voxels: VoxelMap, path: Path | str, *, datum: Datum | None = None, epsg: int | None = None
) -> None:
    """Write a map in the format that the suffix of ``path`` names.

    Args:
        voxels: The map.
        path: ``.npz`` and ``.zarr`` keep all of it, ``.ot`` and ``.bt`` what OctoMap can hold;
            ``.ply``, ``.glb``, ``.stl``, ``.tif``, ``.xyz`` and ``.vdb`` are for other programs.
        datum: Where the origin lies, for ``.tif``.
        epsg: Or which reference system x and y are of.

    Raises:
        OutputError: There is no such format, or the map cannot be written in it.
        MissingExtraError: The format needs a package that is not installed.
    """
    path = Path(path)
    if path.suffix not in SAVED:
        raise OutputError(
            f"{path.name}: there is no map format {path.suffix!r}; name a file that ends in one of "
            f"{', '.join(SAVED)}"
        )
    if datum is None and epsg is None:
        _SAVERS[path.suffix](voxels, path)
        return
    if path.suffix != ".tif":
        raise OutputError(f"{path.name}: only a GeoTIFF (.tif) takes a datum or EPSG code")
    if datum is not None and epsg is not None:
        raise OutputError(f"{path.name}: takes a datum or an EPSG code, not both")
    save_geotiff(voxels, path, datum, epsg)


def map_file(path: Path | str) -> Path:
    """The map of a result folder; a map itself as it is.

    Raises:
        MapFileError: There is none.
    """
    path = Path(path)
    if path.suffix != ".zarr" and path.is_dir():
        found = [path / name for name in ("map.npz", "map.zarr") if (path / name).exists()]
        if not found:
            raise MapFileError(f"{path}: no result folder, it holds no map.npz or map.zarr")
        path = found[0]
    if not path.exists():
        raise MapFileError(f"{path}: there is no such map file; check the path")
    return path


def load_map(
    path: Path | str, region: Box | None = None, *, memory_bytes: int | None = None
) -> VoxelMap:
    """Read a map: ``.npz``, ``.zarr``, OctoMap's ``.ot`` and ``.bt``, or a result folder's.

    Args:
        path: The file or folder.
        region: Only the blocks that touch this box; of a ``.zarr`` no others are read.
        memory_bytes: What the blocks of a ``.zarr`` may take in memory; those that lie elsewhere
            are read when they are needed, and the map cannot be written to.

    Raises:
        MapFileError: It is missing, is no such map, or is damaged.
        MemoryLimitError: The memory is too little.
        MissingExtraError: The format needs a package that is not installed.
    """
    path = map_file(path)
    if path.suffix == ".zarr":
        return load_zarr(path, region, memory_bytes)
    if memory_bytes is not None:
        raise MapFileError(
            f"{path}: is read whole, so that no limit of memory can hold; give a .zarr"
        )
    if path.suffix in (".ot", ".bt"):
        voxels = load_octomap(path)
    elif path.suffix in SAVED and path.suffix != ".npz":
        raise MapFileError(f"{path}: {path.suffix} cannot be read back; give {', '.join(LOADED)}")
    else:
        voxels = load_npz(path)
    return voxels if region is None else cropped(voxels, region)
