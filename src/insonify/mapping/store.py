"""Where a map's blocks are kept: in memory, behind all that a store on disk would have to offer."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from insonify.types import Array, Float32, Int32, Int64

BLOCK = 8
VOXELS_PER_BLOCK = BLOCK**3
BYTES_PER_VOXEL = 5
"""Log-odds, and what was seen."""


class BlockStore(Protocol):
    """Blocks of voxels by slot, the order in which they were made.

    The arrays hold all blocks there are; kernels write into them in place, so a store on disk gives
    arrays that are mapped into memory.
    """

    @property
    def coords(self) -> Int32:
        """Block indices (blocks, 3)."""

    @property
    def log_odds(self) -> Float32:
        """(blocks, 512), x outermost."""

    @property
    def seen(self) -> Array:
        """(blocks, 512) uint8."""

    def allocate(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3), making those that are new, all zeros."""

    def find(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3); -1 for blocks that do not exist."""


class MemoryStore:
    """Arrays that double when they are full."""

    def __init__(self) -> None:
        """No blocks."""
        self._count = 0
        self._keys = np.zeros(0, np.int64)  # sorted, and the slot of each
        self._slots = np.zeros(0, np.int64)
        self._coords = np.zeros((64, 3), np.int32)
        self._log_odds = np.zeros((64, VOXELS_PER_BLOCK), np.float32)
        self._seen = np.zeros((64, VOXELS_PER_BLOCK), np.uint8)

    @property
    def coords(self) -> Int32:
        """Block indices (blocks, 3)."""
        return self._coords[: self._count]

    @property
    def log_odds(self) -> Float32:
        """(blocks, 512), x outermost."""
        return self._log_odds[: self._count]

    @property
    def seen(self) -> Array:
        """(blocks, 512) uint8."""
        return self._seen[: self._count]

    def allocate(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3), making those that are new, all zeros."""
        slots = self.find(coords)
        new = np.flatnonzero(slots < 0)
        if len(new) == 0:
            return slots
        keys, at, which = np.unique(_keys(coords[new]), return_index=True, return_inverse=True)
        order = np.argsort(np.argsort(at))  # in the order in which they are asked for
        made = self._count + order
        slots[new] = made[which]
        self._reserve(self._count + len(keys))
        self._coords[made] = coords[new][at]
        self._count += len(keys)
        places = np.searchsorted(self._keys, keys)
        self._keys = np.insert(self._keys, places, keys)
        self._slots = np.insert(self._slots, places, made)
        return slots

    def find(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3); -1 for blocks that do not exist."""
        keys = _keys(coords)
        if self._count == 0:
            return np.full(len(keys), -1, np.int64)
        at = np.minimum(np.searchsorted(self._keys, keys), self._count - 1)
        return np.where(self._keys[at] == keys, self._slots[at], -1)

    def _reserve(self, blocks: int) -> None:
        capacity = len(self._coords)
        if blocks <= capacity:
            return
        grown = max(blocks, 2 * capacity)
        for name in ("_coords", "_log_odds", "_seen"):
            old = getattr(self, name)
            new = np.zeros((grown, *old.shape[1:]), old.dtype)
            new[:capacity] = old
            setattr(self, name, new)


def cell_of(voxels: Int64) -> Int64:
    """Where voxels (..., 3), by their indices, stand in their blocks."""
    return np.asarray(np.asarray(voxels, np.int64) % BLOCK @ np.array([BLOCK * BLOCK, BLOCK, 1]))


def _keys(coords: Int32) -> Int64:
    """One integer for each block index (N, 3), distinct for indices within +-1,000,000."""
    keys: Int64 = np.asarray(coords, np.int64) @ np.array([1 << 42, 1 << 21, 1])
    return keys
