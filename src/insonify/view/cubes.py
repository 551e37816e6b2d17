"""A map as it is drawn: cubes with a value each, few enough for a browser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.mapping.voxels import (
    BLOCK,
    IN_VIEW,
    VOXELS_PER_BLOCK,
    Blocks,
    VoxelMap,
    picked,
    probability_from_log_odds,
)
from insonify.planning.entropy import binary_entropy
from insonify.types import Array, Bool, Box, Float32, Int32, Int64

MOST_CUBES = 300_000
"""More than this makes a page slow; they are merged, eight into one, until they are fewer."""
LEAST_ENTROPY_BITS = 0.5
_BITS = 21
_MIDDLE = 1 << (_BITS - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Cubes:
    """Cubes of one size on a grid that has a corner at the world's origin.

    Attributes:
        index: (N, 3) whole steps of ``edge_m`` from the origin.
        value: (N,) probability or entropy; of merged cubes the largest.
        voxel_m: Edge length of the map's voxels.
        times: Edge length of a cube in voxels: 1, or 2, 4, 8... where voxels are merged.
        count: How many voxels they stand for, also those inside, which are not drawn.
    """

    index: Int32
    value: Float32
    voxel_m: float
    times: int
    count: int

    @property
    def edge_m(self) -> float:
        """Edge length of a cube."""
        return self.times * self.voxel_m

    @property
    def centres_m(self) -> Float32:
        """(N, 3), world frame."""
        return ((self.index + 0.5) * self.edge_m).astype(np.float32)

    @property
    def size_bytes(self) -> int:
        """Memory that they take."""
        return self.index.nbytes + self.value.nbytes


def occupied_cubes(voxels: VoxelMap, region: Box) -> tuple[Cubes, Cubes]:
    """Occupied voxels inside a region and outside it, by probability.

    Those with six occupied neighbours cannot be seen and are left out.
    """
    within, beyond = _Gathered(voxels.voxel_m), _Gathered(voxels.voxel_m)
    for part in voxels.parts():
        some = _some(part, np.asarray((part.log_odds > 0.0).any(axis=1), bool))
        occupied = some.log_odds > 0.0
        near, bare = voxels.inside(some.coords, region), exposed(voxels, some)
        for gathered, mask in ((within, occupied & near), (beyond, occupied & ~near)):
            gathered.count += int(np.count_nonzero(mask))
            shown = picked(some, mask & bare)
            gathered.add(shown.index, probability_from_log_odds(shown.log_odds))
    return within.cubes(), beyond.cubes()


def undecided_cubes(voxels: VoxelMap, region: Box) -> Cubes:
    """Voxels of a region that have been in view and are still undecided, by entropy in bits."""
    gathered = _Gathered(voxels.voxel_m)
    for part in voxels.parts(region):
        entropy = binary_entropy(probability_from_log_odds(part.log_odds))
        doubtful = ((part.seen & IN_VIEW) > 0) & (entropy >= LEAST_ENTROPY_BITS)
        found = picked(part, doubtful & voxels.inside(part.coords, region))
        gathered.count += len(found.index)
        gathered.add(found.index, binary_entropy(probability_from_log_odds(found.log_odds)))
    return gathered.cubes()


def exposed(voxels: VoxelMap, part: Blocks) -> Bool:
    """Which voxels (N, 512) of some blocks have a neighbour across a face that is not occupied."""
    cells = (part.log_odds > 0.0).reshape(-1, BLOCK, BLOCK, BLOCK)
    bare = np.zeros_like(cells)
    for axis in range(3):
        for step in (-1, 1):
            towards = np.zeros(3, np.int32)
            towards[axis] = step
            beside = np.roll(cells, -step, axis + 1)
            edge, far = [slice(None)] * 4, [slice(None)] * 4
            edge[axis + 1] = slice(-1, None) if step > 0 else slice(0, 1)
            far[axis + 1] = slice(0, 1) if step > 0 else slice(-1, None)
            there = voxels.read(part.coords + towards).log_odds > 0.0
            beside[tuple(edge)] = there.reshape(cells.shape)[tuple(far)]
            bare |= ~beside
    return bare.reshape(-1, VOXELS_PER_BLOCK)


class _Gathered:
    """Voxels that come part by part, merged whenever they are too many."""

    def __init__(self, voxel_m: float) -> None:
        self.voxel_m, self.count = voxel_m, 0
        self._times = 1
        self._parts: list[tuple[Int64, Float32]] = []
        self._held = 0

    def add(self, index: Int64, value: Float32) -> None:
        """Take voxels (N, 3) of the map, and their values (N,)."""
        self._parts.append(_coarser(index, value, self._times))
        self._held += len(self._parts[-1][0])
        if self._held > 4 * MOST_CUBES:
            self._gather()

    def cubes(self) -> Cubes:
        """All that came."""
        index, value = self._gather()
        return Cubes(index.astype(np.int32), value, self.voxel_m, self._times, self.count)

    def _gather(self) -> tuple[Int64, Float32]:
        none = (np.empty((0, 3), np.int64), np.empty(0, np.float32))
        index, value = (np.concatenate(all_) for all_ in zip(none, *self._parts, strict=True))
        if self._times > 1:
            index, value = _distinct(index, value)
        while len(index) > MOST_CUBES:
            index, value = _coarser(index, value, 2)
            self._times *= 2
        self._parts, self._held = [(index, value)], len(index)
        return index, value


def _coarser(index: Int64, value: Float32, times: int) -> tuple[Int64, Float32]:
    """Cubes that are so many times as large, and the largest value of each."""
    return (index, value) if times == 1 else _distinct(index // times, value)


def _distinct(index: Int64, value: Float32) -> tuple[Int64, Float32]:
    keys, first, group = np.unique(grid_keys(index), return_index=True, return_inverse=True)
    largest = np.zeros(len(keys), np.float32)
    np.maximum.at(largest, group, value)
    return index[first], largest


def _some(part: Blocks, rows: Bool) -> Blocks:
    return Blocks(part.coords[rows], part.log_odds[rows], part.seen[rows])


def grid_keys(index: Array) -> Array:
    """One integer for each index (N, 3)."""
    keys: Array = (index.astype(np.int64) + _MIDDLE) @ np.array([1, 1 << _BITS, 1 << 2 * _BITS])
    return keys
