"""What is taken out of a map, all of a box or single voxels, and what their numbers mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.mapping.store import BLOCK, Blocks
from insonify.types import Array, Bool, Float32, Float64, Int64

IN_VIEW = 1
OBSERVED = 2
SURFACE = 4


@dataclass(frozen=True, slots=True, eq=False)
class VoxelWindow:
    """A dense copy of a box of voxels, indexed [x, y, z].

    Attributes:
        first: World index of voxel [0, 0, 0].
        voxel_m: Edge length.
        log_odds: (nx, ny, nz) float32; 0 where nothing is known.
        seen: (nx, ny, nz) uint8, bits IN_VIEW, OBSERVED and SURFACE.
        marked: Whether the map tells surface from solid, by SURFACE.
    """

    first: tuple[int, int, int]
    voxel_m: float
    log_odds: Float32
    seen: np.ndarray
    marked: bool = False

    @property
    def probability(self) -> Float32:
        """Occupancy probability p(m) of every voxel; 0.5 where nothing is known."""
        return probability_from_log_odds(self.log_odds)

    @property
    def occupied(self) -> Bool:
        """Voxels more likely occupied than not."""
        occupied: Bool = self.log_odds > 0.0
        return occupied

    @property
    def surface(self) -> Bool:
        """Voxels that the surface of an object passes through.

        See `surface_of`.
        """
        return surface_of(self.log_odds, self.seen, self.marked)

    def centres_m(self, mask: Bool) -> Float64:
        """World coordinates (N, 3) of the centres of the masked voxels, in x, y, z order."""
        index = np.argwhere(mask) + self.first
        return (index.astype(np.float64) + 0.5) * self.voxel_m


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """Some voxels of a map.

    Attributes:
        index: World indices (N, 3).
        log_odds: (N,).
        seen: (N,) uint8, bits IN_VIEW, OBSERVED and SURFACE.
    """

    index: Int64
    log_odds: Float32
    seen: Array


def picked(part: Blocks, mask: Bool) -> Voxels:
    """The masked voxels (N, 512) of some blocks."""
    row, cell = np.nonzero(mask)
    within = np.column_stack(np.unravel_index(cell, (BLOCK, BLOCK, BLOCK)))
    index = part.coords[row].astype(np.int64) * BLOCK + within
    return Voxels(index, part.log_odds[row, cell], part.seen[row, cell])


def copy_blocks(part: Blocks, low: Int64, high: Int64, log_odds: Float32, seen: np.ndarray) -> None:
    """Copy what some blocks have from voxel ``low`` to ``high`` into dense arrays of that size."""
    corners = part.coords.astype(np.int64) * BLOCK
    touching = ((corners < high) & (corners + BLOCK > low)).all(axis=1)
    for slot in np.flatnonzero(touching):
        start = np.maximum(corners[slot], low)
        stop = np.minimum(corners[slot] + BLOCK, high)
        inside = tuple(map(slice, start - corners[slot], stop - corners[slot]))
        target = tuple(map(slice, start - low, stop - low))
        log_odds[target] = part.log_odds[slot].reshape(BLOCK, BLOCK, BLOCK)[inside]
        seen[target] = part.seen[slot].reshape(BLOCK, BLOCK, BLOCK)[inside]


def surface_of(log_odds: Float32, seen: np.ndarray, marked: bool) -> Bool:
    """Voxels that the surface of an object passes through, any shape.

    Those that the mapper has marked; a mapper that marks none in all the map, as the papers' does,
    makes no difference between surface and what is occupied.
    """
    surface: Bool = (seen & SURFACE) > 0 if marked else log_odds > 0.0
    return surface


def probability_from_log_odds(log_odds: Float32) -> Float32:
    """P = 1 / (1 + exp(-l)), any shape."""
    return (1.0 / (1.0 + np.exp(-log_odds))).astype(np.float32)
