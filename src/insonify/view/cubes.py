"""A map as it is drawn: cubes with a value each, few enough for a browser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.mapping.voxels import BLOCK, IN_VIEW, VoxelMap, probability_from_log_odds
from insonify.planning.entropy import binary_entropy
from insonify.types import Array, Bool, Box, Float32, Int32

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
    occupied = voxels.log_odds > 0.0
    count = int(voxels.window(region).occupied.sum())
    index, log_odds = _voxels(voxels, occupied & exposed(voxels, occupied), voxels.log_odds)
    probability = probability_from_log_odds(log_odds)
    inside = _inside(index, voxels.voxel_m, region)
    return (
        _merged(index[inside], probability[inside], voxels.voxel_m, count),
        _merged(index[~inside], probability[~inside], voxels.voxel_m, int(occupied.sum()) - count),
    )


def undecided_cubes(voxels: VoxelMap, region: Box) -> Cubes:
    """Voxels of a region that have been in view and are still undecided, by entropy in bits."""
    entropy = binary_entropy(probability_from_log_odds(voxels.log_odds))
    doubtful = ((voxels.seen & IN_VIEW) > 0) & (entropy >= LEAST_ENTROPY_BITS)
    low_m = voxels.coords * voxels.block_m
    far = (low_m > region.high_m) | (low_m + voxels.block_m < region.low_m)
    doubtful[far.any(axis=1)] = False
    index, value = _voxels(voxels, doubtful, entropy)
    inside = _inside(index, voxels.voxel_m, region)
    return _merged(index[inside], value[inside], voxels.voxel_m, int(inside.sum()))


def exposed(voxels: VoxelMap, filled: Bool) -> Bool:
    """Which voxels (blocks, 512) have a neighbour across a face that is not ``filled``."""
    cells = filled.reshape(-1, BLOCK, BLOCK, BLOCK)
    bare = np.zeros_like(cells)
    for axis in range(3):
        for step in (-1, 1):
            towards = np.zeros(3, np.int32)
            towards[axis] = step
            beside = np.roll(cells, -step, axis + 1)
            edge, far = [slice(None)] * 4, [slice(None)] * 4
            edge[axis + 1] = slice(-1, None) if step > 0 else slice(0, 1)
            far[axis + 1] = slice(0, 1) if step > 0 else slice(-1, None)
            slots = voxels.find(voxels.coords + towards)
            known = (slots >= 0)[:, None, None, None]
            beside[tuple(edge)] = cells[slots][tuple(far)] & known
            bare |= ~beside
    return bare.reshape(filled.shape)


def _voxels(voxels: VoxelMap, mask: Bool, values: Float32) -> tuple[Int32, Float32]:
    """World indices (N, 3) of masked voxels, and their values."""
    slot, voxel = np.nonzero(mask)
    within = np.column_stack(np.unravel_index(voxel, (BLOCK, BLOCK, BLOCK)))
    return (voxels.coords[slot] * BLOCK + within).astype(np.int32), values[slot, voxel]


def _inside(index: Int32, voxel_m: float, region: Box) -> Bool:
    """Which voxels have their centres in a box."""
    centre_m = (index + 0.5) * voxel_m
    inside = np.logical_and(centre_m >= region.low_m, centre_m <= region.high_m)
    return np.asarray(inside.all(axis=1), bool)


def _merged(index: Int32, value: Float32, voxel_m: float, count: int) -> Cubes:
    times = 1
    while len(index) > MOST_CUBES:
        keys, group = np.unique(grid_keys(index >> 1), return_inverse=True)
        largest = np.zeros(len(keys), np.float32)
        np.maximum.at(largest, group, value)
        first = np.zeros(len(keys), np.int64)
        first[group] = np.arange(len(index))
        index, value, times = index[first] >> 1, largest, 2 * times
    return Cubes(index, value.astype(np.float32), voxel_m, times, count)


def grid_keys(index: Array) -> Array:
    """One integer for each index (N, 3)."""
    keys: Array = (index.astype(np.int64) + _MIDDLE) @ np.array([1, 1 << _BITS, 1 << 2 * _BITS])
    return keys
