"""Seabeds as height grids: procedural with a seed, or from a raster file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from insonify import memory
from insonify.errors import MeshError, reading
from insonify.limits import MOST_HEIGHTS
from insonify.pictures import opened_picture
from insonify.types import Array, Float64, Int32

BYTES_PER_HEIGHT = 400
"""With its two triangles, and the tree that rays go down."""
RASTER_SUFFIXES = (".npy", ".tif", ".tiff", ".png", ".asc")


@dataclass(frozen=True, slots=True, eq=False)
class Seabed:
    """Heights on a regular grid, bilinear in between and level beyond the edge.

    Args:
        heights_m: (rows over y, columns over x), metres, world frame.
        cell_m: Spacing of the grid.
        origin_m: World (x, y) of ``heights_m[0, 0]``.
    """

    heights_m: Float64
    cell_m: float
    origin_m: tuple[float, float]

    def height_at(self, x_m: Float64, y_m: Float64) -> Float64:
        """Seabed height at points of any shape, metres."""
        rows = (np.asarray(y_m) - self.origin_m[1]) / self.cell_m
        columns = (np.asarray(x_m) - self.origin_m[0]) / self.cell_m
        heights: Float64 = ndimage.map_coordinates(
            self.heights_m, [rows, columns], order=1, mode="nearest"
        )
        return heights

    def tilted(self, slope_rad: float, towards_rad: float) -> Seabed:
        """Turned into a slope about its middle.

        Args:
            slope_rad: How steep.
            towards_rad: Where it rises to; 0 is east.
        """
        if slope_rad == 0.0:
            return self
        rows, columns = self.heights_m.shape
        north = (np.arange(rows) - (rows - 1) / 2) * (self.cell_m * math.sin(towards_rad))
        east = (np.arange(columns) - (columns - 1) / 2) * (self.cell_m * math.cos(towards_rad))
        rise_m = math.tan(slope_rad) * (north[:, None] + east)
        return Seabed(self.heights_m + rise_m, self.cell_m, self.origin_m)

    def triangles(self) -> tuple[Float64, Int32]:
        """The grid as vertices (N, 3) and faces (M, 3), normals up."""
        rows, columns = self.heights_m.shape
        x = self.origin_m[0] + np.arange(columns) * self.cell_m
        y = self.origin_m[1] + np.arange(rows) * self.cell_m
        return grid_triangles(x, y, self.heights_m)


def grid_triangles(x_m: Array, y_m: Array, heights_m: Float64) -> tuple[Float64, Int32]:
    """Heights (rows over y, columns over x) as vertices (N, 3) and faces (M, 3), facing up."""
    rows, columns = heights_m.shape
    grid_x, grid_y = np.meshgrid(x_m, y_m)
    vertices = np.column_stack([grid_x.ravel(), grid_y.ravel(), heights_m.ravel()])
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.column_stack([first, first + 1, first + columns])
    upper = np.column_stack([first + 1, first + columns + 1, first + columns])
    return vertices, np.vstack([lower, upper]).astype(np.int32)


def procedural_seabed(
    rng: np.random.Generator,
    *,
    size_m: float,
    depth_m: float,
    relief_m: float,
    correlation_m: float,
    cell_m: float,
    centre_m: tuple[float, float] = (0.0, 0.0),
) -> Seabed:
    """A square of smooth random relief, level on average.

    Args:
        rng: Where the relief comes from.
        size_m: Edge of the square.
        depth_m: Mean depth; the mean height is ``-depth_m``.
        relief_m: Standard deviation of the height.
        correlation_m: Standard deviation of the Gaussian that smooths white noise into relief.
        cell_m: Grid spacing.
        centre_m: World (x, y) of its centre.
    """
    count = max(2, round(size_m / cell_m) + 1)
    noise = ndimage.gaussian_filter(
        rng.standard_normal((count, count)), correlation_m / cell_m, mode="wrap"
    )
    noise -= noise.mean()
    spread = float(noise.std())
    relief = noise * (relief_m / spread) if spread > 0.0 else noise * 0.0
    edge = -(count - 1) * cell_m / 2
    return Seabed(relief - depth_m, cell_m, (centre_m[0] + edge, centre_m[1] + edge))


def raster_seabed(path: Path, *, cell_m: float, depth_m: float) -> Seabed:
    """A seabed from a file of heights, centred on the world's origin.

    Heights are metres, positive up; ``depth_m`` is subtracted.  The first row is the northern
    edge, as in maps; a ``.npy`` array is taken the same way.  An ESRI ``.asc`` grid brings its
    own cell size.

    Args:
        path: ``.npy``, ``.tif``, ``.png`` (grey values are metres) or ESRI ``.asc`` file.
        cell_m: Grid spacing.
        depth_m: Depth of the raster's zero height.

    Raises:
        MeshError: The file is missing, unreadable, not a 2D grid, or has heights that are not
            finite.
    """
    if path.suffix.lower() not in RASTER_SUFFIXES:
        raise MeshError(f"{path}: a seabed raster ends in {', '.join(RASTER_SUFFIXES)}")
    if not path.is_file():
        raise MeshError(f"{path}: there is no such seabed raster; check the path")
    with reading(path, "a seabed raster", MeshError, Exception):
        heights, cell_m = _read_raster(path, cell_m)
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise MeshError(f"{path}: a seabed needs a grid of at least 2 x 2, not {heights.shape}")
    if not np.isfinite(heights).all():
        bad = int((~np.isfinite(heights)).sum())
        raise MeshError(f"{path}: {bad} heights are not finite numbers; fill the gaps first")
    rows, columns = heights.shape
    origin = (-(columns - 1) * cell_m / 2, -(rows - 1) * cell_m / 2)
    return Seabed(np.ascontiguousarray(heights[::-1]) - depth_m, cell_m, origin)


def _read_raster(path: Path, cell_m: float) -> tuple[Float64, float]:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        array = np.load(path, mmap_mode="r", allow_pickle=False)  # its size, before its values
        _check_size(path, array.size)
        if array.dtype.kind not in "iuf":
            raise ValueError(f"its values are {array.dtype}, not real numbers")
        return array.astype(np.float64), cell_m
    if suffix == ".asc":
        return _read_asc(path)
    with opened_picture(path, "a seabed raster", MeshError, MOST_HEIGHTS) as picture:
        _check_size(path, picture.width * picture.height)
        if picture.mode[0] not in "LIF1":
            raise ValueError(f"its pixels are {picture.mode}, not grey heights")
        return np.asarray(picture, dtype=np.float64), cell_m


def _check_size(path: Path, count: int) -> None:
    """Refuse a raster of too many heights.

    Raises:
        MeshError: It has more than `insonify.limits.MOST_HEIGHTS`, or than memory holds as a mesh.
    """
    if count > MOST_HEIGHTS:
        raise MeshError(f"{path}: {count:,} heights are more than {MOST_HEIGHTS:,}; thin them out")
    if not memory.fits(count * BYTES_PER_HEIGHT):
        raise MeshError(f"{path}: it would need {memory.shortage(count * BYTES_PER_HEIGHT)}")


def _read_asc(path: Path) -> tuple[Float64, float]:
    """Heights and cell size of an ESRI ASCII grid."""
    known = {"ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter"}
    known |= {"cellsize", "nodata_value"}
    lines = path.read_text(encoding="utf-8").splitlines()
    header: dict[str, float] = {}
    for line in lines:
        words = line.split()
        if len(words) != 2 or words[0].lower() not in known:
            break
        header[words[0].lower()] = float(words[1])
    missing = {"ncols", "nrows", "cellsize"} - set(header)
    if missing:
        raise ValueError(f"its header lacks {', '.join(sorted(missing))}")
    if not 0.0 < header["cellsize"] < np.inf:
        raise ValueError(f"its cellsize is {header['cellsize']:g}")
    heights = np.array([[float(w) for w in line.split()] for line in lines[len(header) :] if line])
    _check_size(path, heights.size)
    size = (int(header["nrows"]), int(header["ncols"]))
    if heights.shape != size:
        raise ValueError(f"it holds a grid of {heights.shape} and its header says {size}")
    heights[heights == header.get("nodata_value", np.nan)] = np.nan
    return heights, header["cellsize"]
