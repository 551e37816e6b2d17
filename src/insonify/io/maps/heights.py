"""The height of the seabed and of what stands on it, with its uncertainty.

The height of a column is that of its highest occupied voxel: the shoalest reading, as charts give
it, since what a vehicle must not touch is the top.  A sonar's beam is wide in elevation, so that
the top errs upwards, to the safe side.

Its uncertainty follows from the map: going down the column, voxel k is the first to be occupied
with the probability p_k times the product of 1 - p_j over the observed voxels above it.  Given is
the root mean square distance of that first voxel from the height, and a voxel's own
``voxel_m / sqrt(12)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from insonify.errors import OutputError
from insonify.mapping.voxels import BLOCK, OBSERVED, VoxelMap, picked
from insonify.types import Float32, Float64, Int64

MOST_CELLS = 100_000_000


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights over a grid of the map's columns.

    Attributes:
        west_m: x of the grid's western edge.
        north_m: y of its northern edge.
        cell_m: Edge of a cell.
        height_m: (rows, columns), the first row northernmost; not a number where nothing stands.
        uncertainty_m: The same shape, one standard deviation.
    """

    west_m: float
    north_m: float
    cell_m: float
    height_m: Float32
    uncertainty_m: Float32


def height_grid(voxels: VoxelMap, path: Path) -> HeightGrid:
    """The highest occupied voxel of each column.

    Raises:
        OutputError: No voxel is occupied, or the grid would be too large.
    """
    low, high = voxels.span(voxels.extent())
    across, along = (high - low)[:2].tolist()
    if across * along > MOST_CELLS:
        raise OutputError(
            f"{path.name}: a grid of {across} x {along} cells is too large; "
            "export a part of the map (--region)"
        )
    heights, spreads = np.full((2, along, across), np.nan, np.float32)
    for index, log_odds in _columns(voxels):
        places, top, spread = _tops(index, log_odds)
        rows, columns = along - 1 - (places[:, 1] - low[1]), places[:, 0] - low[0]
        heights[rows, columns] = (top + 0.5) * voxels.voxel_m + voxels.origin_m[2]
        spreads[rows, columns] = spread * voxels.voxel_m
    found = np.isfinite(heights)
    rows, columns = (np.flatnonzero(found.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        raise OutputError(
            f"{path.name}: the map holds no occupied voxel, so that it has no heights"
        )
    kept = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return HeightGrid(
        float((low[0] + columns[0]) * voxels.voxel_m) + voxels.origin_m[0],
        float((low[1] + along - rows[0]) * voxels.voxel_m) + voxels.origin_m[1],
        voxels.voxel_m,
        heights[kept].copy(),
        spreads[kept].copy(),
    )


def _columns(voxels: VoxelMap) -> Iterator[tuple[Int64, Float64]]:
    """The observed voxels (N, 3), and their log-odds, some columns at a time, each whole."""
    index, log_odds = np.empty((0, 3), np.int64), np.empty(0)
    for part in voxels.parts(order="ascending"):
        some = picked(part, (part.seen & OBSERVED) > 0)
        index = np.concatenate([index, some.index])
        log_odds = np.concatenate([log_odds, some.log_odds])
        open_ = (index[:, :2] // BLOCK == part.coords[-1, :2]).all(axis=1)  # the next has more
        yield index[~open_], log_odds[~open_]
        index, log_odds = index[open_], log_odds[open_]
    yield index, log_odds


def _tops(index: Int64, log_odds: Float64) -> tuple[Int64, Float64, Float64]:
    """Of columns in which a voxel is occupied: x and y (N, 2), the highest such, its spread."""
    if not len(index):
        return np.empty((0, 2), np.int64), np.empty(0), np.empty(0)
    order = np.lexsort((-index[:, 2], index[:, 1], index[:, 0]))
    index, log_odds = index[order], log_odds[order]
    begins = np.flatnonzero(np.r_[True, (np.diff(index[:, :2], axis=0) != 0).any(axis=1)])
    deep = np.diff(np.r_[begins, len(index)])
    which = np.repeat(np.arange(len(begins)), deep)
    rank = np.arange(len(index)) - begins[which]

    occupied = np.flatnonzero(log_odds > 0)
    columns, first = np.unique(which[occupied], return_index=True)
    top = np.full(len(begins), np.nan)
    top[columns] = index[occupied[first], 2]
    missed = np.zeros((len(begins), int(deep.max())))
    missed[which, rank] = -np.logaddexp(0.0, log_odds)
    above = (np.cumsum(missed, axis=1) - missed)[which, rank]
    weight = np.exp(above - np.logaddexp(0.0, -log_odds))
    moment = np.bincount(which, weight * (index[:, 2] - top[which]) ** 2)
    square = moment / np.bincount(which, weight) + 1.0 / 12.0
    return index[begins[columns], :2], top[columns], np.sqrt(square[columns])


def save_xyz(voxels: VoxelMap, path: Path) -> None:
    """Write ``x y z uncertainty`` in metres, one column of the map a line, from north to south.

    Raises:
        OutputError: No voxel is occupied.
    """
    grid = height_grid(voxels, path)
    rows, columns = np.nonzero(np.isfinite(grid.height_m))
    x_m = grid.west_m + (columns + 0.5) * grid.cell_m
    y_m = grid.north_m - (rows + 0.5) * grid.cell_m
    found = (grid.height_m[rows, columns], grid.uncertainty_m[rows, columns])
    with path.open("w", encoding="ascii", newline="\n") as file:
        np.savetxt(file, np.column_stack([x_m, y_m, *found]), fmt="%.4f")
