"""What a map holds that is worth a look: places that stand out, how undecided they are, obstacles.

Any mapper's map will do: nothing but log-odds is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from insonify.mapping.voxels import OBSERVED, VoxelMap, VoxelWindow
from insonify.planning.dbscan import dbscan
from insonify.types import Array, Bool, Box, Float32, Float64, Pose

_CELL_M = 0.4
"""Columns of the map are looked at in cells so wide."""
_USUAL, _SPREAD = 0.5, 0.84
"""Quantiles of all cells: what is usual, and how far it spreads."""
_OUTSTANDING = 2.0
"""Spreads above what is usual at which a cell stands out."""
_LEAST_M, _ENOUGH_M = 0.1, 1.5
"""Evidence of a cell, log-odds x metres of height: what any find has, and what any cell has that
stands out where most of the map does."""
_APART_CELLS, _LEAST_CELLS = 2.3, 3
"""Cells so near each other are of one find, which has so many at least."""
_ROOM_M = 0.5
"""A find is so much larger than what stands out."""
_MOST_VOXELS = 1500
"""Of a find, so many stand for all of them."""
_UNSEEN = 0.1
"""Doubt about a voxel of a find that nothing is known of: most of what is near one is water."""


@dataclass(frozen=True, slots=True, eq=False)
class Find:
    """Something that is worth a look.

    Attributes:
        box: What holds it, with some room.
        voxels_m: (N, 3) centres of voxels that stand for all in the box, world frame.
        doubts: (N,) how many voxels held wrongly each stands for.
        doubt: How many in its parts are expected to be held for what they are not.
        boxes: Its parts.
        held: (all of them,) which voxels of its parts are held for occupied.
    """

    box: Box
    voxels_m: Float64
    doubts: Float64
    doubt: float
    boxes: tuple[Box, ...]
    held: Bool


def find_of(box: Box, parts: Sequence[Find]) -> Find:
    """Several finds as one, in a box of its own."""
    return Find(
        box,
        np.concatenate([part.voxels_m for part in parts]),
        np.concatenate([part.doubts for part in parts]),
        sum(part.doubt for part in parts),
        tuple(part.box for part in parts),
        np.concatenate([part.held for part in parts]),
    )


def find_in(voxels: VoxelMap, box: Box) -> Find:
    """All that is in a box as a find."""
    window = voxels.window(box)
    p = window.probability
    doubts = np.where(window.seen & OBSERVED, np.minimum(p, 1.0 - p), _UNSEEN).astype(np.float64)
    stride = max(1, math.ceil(doubts.size / _MOST_VOXELS))
    chosen: Bool = np.zeros(doubts.shape, bool)
    chosen.reshape(-1)[stride // 2 :: stride] = True
    return Find(
        box,
        window.centres_m(chosen),
        doubts[chosen] * stride,
        float(doubts.sum()),
        (box,),
        window.occupied.ravel(),
    )


def outstanding(voxels: VoxelMap, region: Box, looked_at: Sequence[Box] = ()) -> list[Box]:
    """Boxes around what stands out, the largest first.

    A column's evidence is the sum of its positive log-odds.  One echo in a whole arc gives much of
    the seabed a little of it, so what stands out is told by what is usual in this map.

    Args:
        voxels: The map.
        region: Where finds are looked for.
        looked_at: Places around what was looked at, into which finds of the region may go on.
    """
    boxes = [region, *looked_at]
    low_m, high_m = (
        np.array([getattr(box, name)[:2] for box in boxes]) for name in ("low_m", "high_m")
    )
    z0, z1 = region.low_m[2], region.high_m[2]
    window = voxels.window(Box.of((*low_m.min(axis=0), z0), (*high_m.max(axis=0), z1)))
    evidence, width_m = _cells(np.maximum(window.log_odds, 0.0).sum(axis=2), window.voxel_m)
    corner = np.array(window.first[:2]) * window.voxel_m
    x, y = (corner[k] + (np.arange(evidence.shape[k]) + 0.5) * width_m for k in range(2))
    within = [
        ((x > a) & (x < c))[:, None] & (y > b) & (y < d)
        for (a, b), (c, d) in zip(low_m, high_m, strict=True)
    ]
    if not within[0].any():
        return []
    usual, spread = np.quantile(evidence[within[0]], (_USUAL, _SPREAD))
    least_m = np.clip(usual + _OUTSTANDING * (spread - usual), _LEAST_M, _ENOUGH_M)
    stands_out = evidence > least_m
    return [
        _lowered(voxels, Box.of((*corner + a * width_m, z0), (*corner + b * width_m, z1)))
        for a, b in _clusters(stands_out & np.any(within, axis=0), within[0])
    ]


def _cells(columns: Float32, voxel_m: float) -> tuple[Float32, float]:
    """Means over square cells, times a voxel's height; and their width.

    What is left over at the ends is left out.
    """
    size = max(1, round(_CELL_M / voxel_m))
    nx, ny = (n // size for n in columns.shape)
    whole = columns[: nx * size, : ny * size].reshape(nx, size, ny, size)
    return whole.mean(axis=(1, 3), dtype=np.float32) * np.float32(voxel_m), size * voxel_m


def _clusters(stands_out: Bool, inside: Bool) -> list[tuple[Array, Array]]:
    """First and last cells of clusters with a part inside, the largest first."""
    cells = np.argwhere(stands_out)
    if not len(cells):
        return []
    labels = dbscan(np.column_stack([cells, np.zeros(len(cells), int)]), _APART_CELLS, _LEAST_CELLS)
    found = [cells[labels == label] for label in range(labels.max() + 1)]
    found = [own for own in found if inside[tuple(own.T)].any()]
    found.sort(key=lambda own: -len(own))
    return [(own.min(axis=0), own.max(axis=0) + 1) for own in found]


def _lowered(voxels: VoxelMap, box: Box) -> Box:
    """A find's box: with room around it, and no higher than what is occupied in it."""
    (x0, y0, z0), (x1, y1, z1) = box.low_m, box.high_m
    occupied = voxels.window(box).occupied.any(axis=(0, 1))
    top = z0 + (int(np.flatnonzero(occupied)[-1]) + 1) * voxels.voxel_m if occupied.any() else z0
    room = _ROOM_M
    return Box((x0 - room, y0 - room, z0), (x1 + room, y1 + room, min(top + room, z1)))


class Obstacles:
    """How high a vehicle has to fly over each place, as far as the map tells.

    In the region all is an obstacle that was never shown to be free; elsewhere what is occupied.
    """

    def __init__(self, voxels: VoxelMap, region: Box, clearance_m: float, beyond_m: float) -> None:
        """Read a map off.

        Args:
            voxels: The map.
            region: Nothing is taller than its top.
            clearance_m: Least distance from anything.
            beyond_m: How far beyond the region, horizontally, the vehicle may go.
        """
        (x0, y0, z0), (x1, y1, z1) = region.low_m, region.high_m
        box = Box((x0 - beyond_m, y0 - beyond_m, z0), (x1 + beyond_m, y1 + beyond_m, z1))
        window = voxels.window(box)
        blocked = window.occupied | (_within(window, region) & ~(window.log_odds < 0.0))
        highest = (blocked * np.arange(1, blocked.shape[2] + 1, dtype=np.int16)).max(axis=2)
        columns = np.where(highest > 0, (window.first[2] + highest) * window.voxel_m, -np.inf)
        reach = 2 * math.ceil((clearance_m + _CELL_M) / window.voxel_m) + 1
        self._least_m = ndimage.maximum_filter(columns, reach) + clearance_m
        self._first, self._voxel_m = window.first, window.voxel_m

    def over(self, poses: list[Pose]) -> list[Pose]:
        """The same poses, raised where they are too low; they climb at 45 degrees at most."""
        index = np.array([[p.x_m, p.y_m] for p in poses]) / self._voxel_m - self._first[:2]
        cell = np.floor(index).astype(np.int64)
        known = ((cell >= 0) & (cell < self._least_m.shape)).all(axis=1)
        least = np.full(len(poses), -np.inf)
        least[known] = self._least_m[tuple(cell[known].T)]
        places = np.array([[p.x_m, p.y_m] for p in poses])
        steps = np.hypot(*np.diff(places, axis=0).T)
        for k, step in enumerate(steps.tolist()):
            least[k + 1] = max(least[k + 1], least[k] - step)
        for k, step in reversed(list(enumerate(steps.tolist()))):
            least[k] = max(least[k], least[k + 1] - step)
        return [
            replace(pose, z_m=z) if z > pose.z_m else pose
            for pose, z in zip(poses, least.tolist(), strict=True)
        ]


def _within(window: VoxelWindow, region: Box) -> Bool:
    """Columns (nx, ny, 1) of a window that are of a region."""
    sides = [
        (np.arange(window.log_odds.shape[k]) + window.first[k] + 0.5) * window.voxel_m
        for k in range(2)
    ]
    x, y = ((s > region.low_m[k]) & (s < region.high_m[k]) for k, s in enumerate(sides))
    return np.asarray((x[:, None] & y)[:, :, None], bool)
