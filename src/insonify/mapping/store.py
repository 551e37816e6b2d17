"""Where a map's blocks are kept: in memory here, on disk in `insonify.io.maps.ondisk`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from insonify.types import Array, Bool, Float32, Int32, Int64

BLOCK = 8
VOXELS_PER_BLOCK = BLOCK**3
BYTES_PER_VOXEL = 5
"""Log-odds, and what was seen."""
TILE = 8
"""Blocks along the edge of a tile: what is kept in one piece on disk."""

Order = Literal["any", "ascending", "tiles"]
"""Of blocks: as it suits the store; by x, y, z; by tile, and in a tile by x, y, z."""
Touches = Callable[[Int32, int], Bool]
"""Which cubes (N, 3), by their indices, are of interest, that are so many blocks along an edge."""
_BATCH = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Some blocks of a map, to be read.

    Attributes:
        coords: Block indices (N, 3).
        log_odds: (N, 512), x outermost.
        seen: (N, 512) uint8.
    """

    coords: Int32
    log_odds: Float32
    seen: Array


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Blocks to be written in place, until the store is asked for others.

    Attributes:
        slots: (N,) rows of the arrays.
        log_odds: (rows, 512), of these blocks and of others.
        seen: The same.
    """

    slots: Int64
    log_odds: Float32
    seen: Array


class BlockStore(Protocol):
    """Blocks of voxels.

    Who goes by `hold`, `read` and `parts` works on every store.  The arrays of all blocks, and
    their rows, are there in memory alone; a store on disk refuses them.
    """

    memory_bytes: int | None
    """What blocks may take in memory, the others being on disk; None if all are in memory."""

    @property
    def count(self) -> int:
        """How many blocks there are."""

    @property
    def bits(self) -> int:
        """All that any voxel was seen as."""

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
        """Rows of blocks (N, 3), making those that are new, all zeros."""

    def find(self, coords: Int32) -> Int64:
        """Rows of blocks (N, 3); -1 for blocks that do not exist."""

    def hold(self, coords: Int32) -> Held:
        """Distinct blocks (N, 3) to be written, making those that are new, all zeros."""

    def read(self, coords: Int32) -> Blocks:
        """Copies of blocks (N, 3); zeros for those that do not exist."""

    def parts(self, touches: Touches | None = None, order: Order = "any") -> Iterator[Blocks]:
        """All blocks, or those of interest, some at a time; not to be written."""


class MemoryStore:
    """Arrays that double when they are full; a block's row is the order in which it was made."""

    memory_bytes: int | None = None

    def __init__(self) -> None:
        """No blocks."""
        self._count = 0
        self._keys = np.zeros(0, np.int64)  # sorted, and the slot of each
        self._slots = np.zeros(0, np.int64)
        self._coords = np.zeros((64, 3), np.int32)
        self._log_odds = np.zeros((64, VOXELS_PER_BLOCK), np.float32)
        self._seen = np.zeros((64, VOXELS_PER_BLOCK), np.uint8)

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return self._count

    @property
    def bits(self) -> int:
        """All that any voxel was seen as."""
        return int(np.bitwise_or.reduce(self.seen, axis=None, initial=0))

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

    def hold(self, coords: Int32) -> Held:
        """Distinct blocks (N, 3) to be written, making those that are new, all zeros."""
        slots = self.allocate(coords)
        return Held(slots, self.log_odds, self.seen)

    def read(self, coords: Int32) -> Blocks:
        """Copies of blocks (N, 3); zeros for those that do not exist."""
        slots = self.find(coords)
        log_odds = np.zeros((len(slots), VOXELS_PER_BLOCK), np.float32)
        seen = np.zeros((len(slots), VOXELS_PER_BLOCK), np.uint8)
        there = slots >= 0
        log_odds[there], seen[there] = self.log_odds[slots[there]], self.seen[slots[there]]
        return Blocks(coords, log_odds, seen)

    def parts(self, touches: Touches | None = None, order: Order = "any") -> Iterator[Blocks]:
        """All blocks, or those of interest; in any order all at once."""
        if touches is None and order == "any":
            yield Blocks(self.coords, self.log_odds, self.seen)
            return
        rows = np.arange(self._count)
        if touches is not None:
            rows = np.flatnonzero(touches(self.coords, 1))
        rows = rows[sorting(self.coords[rows], order)]
        step = max(1, len(rows)) if order == "any" else _BATCH
        for start in range(0, len(rows), step):
            some = rows[start : start + step]
            yield Blocks(self.coords[some], self.log_odds[some], self.seen[some])

    def allocate(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3), making those that are new, all zeros."""
        slots = self.find(coords)
        new = np.flatnonzero(slots < 0)
        if len(new) == 0:
            return slots
        keys, at, which = np.unique(block_keys(coords[new]), return_index=True, return_inverse=True)
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
        keys = block_keys(coords)
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


def sorting(coords: Int32, order: Order) -> Int64:
    """What puts blocks (N, 3) in order."""
    if order == "any":
        return np.arange(len(coords))
    tiles = coords // TILE if order == "tiles" else coords[:, :0]
    return np.lexsort(np.hstack([tiles, coords]).T[::-1])


def block_keys(coords: Int32) -> Int64:
    """One integer for each block index (N, 3), distinct for indices within +-1,000,000."""
    keys: Int64 = np.asarray(coords, np.int64) @ np.array([1 << 42, 1 << 21, 1])
    return keys
