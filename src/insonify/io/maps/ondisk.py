"""A map's blocks on disk, with those used last in memory: maps larger than memory."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

import numpy as np

from insonify.errors import MemoryLimitError
from insonify.io.maps.tiles import (
    BLOCKS_PER_TILE,
    About,
    TileFiles,
    blocks_of,
    describe,
    places_of,
)
from insonify.mapping.store import (
    BYTES_PER_VOXEL,
    TILE,
    VOXELS_PER_BLOCK,
    Blocks,
    Held,
    Order,
    Touches,
    sorting,
)
from insonify.types import Array, Bool, Float32, Int32, Int64

BYTES_PER_BLOCK = VOXELS_PER_BLOCK * BYTES_PER_VOXEL
LEAST_BYTES = 16 * BLOCKS_PER_TILE * BYTES_PER_BLOCK
"""Memory that a store must be given: 16 tiles."""
CHECKPOINT = "checkpoint.npz"
"""Beside the tiles: what there was at the last `TileStore.keep`."""
_SPARE = 1 / 16
"""Of the memory is made free at once, so that tiles are written several at a time."""


class TileStore:
    """Blocks by tiles of 8 x 8 x 8 (a `BlockStore`).

    What is held is written to disk when other tiles need its memory, the tile longest unused first,
    and by `flush`.  Every method may move blocks in memory: arrays of `hold` are good until the
    next call.

    Attributes:
        files: Where its tiles are.
        memory_bytes: What its blocks may take in memory.
    """

    def __init__(self, files: TileFiles, memory_bytes: int, *, writable: bool = True) -> None:
        """A store without blocks.

        Args:
            files: Where its tiles are.
            memory_bytes: What its blocks may take in memory.
            writable: Whether blocks can be held.

        Raises:
            MemoryLimitError: It is less than `LEAST_BYTES`.
        """
        if memory_bytes < LEAST_BYTES:
            raise MemoryLimitError(
                f"--memory: {memory_bytes / 1e6:.3g} MB are too little for a map's blocks; give "
                f"{LEAST_BYTES / 1e6:.0f}MB or more"
            )
        self.files, self._writable = files, writable
        self.memory_bytes: int | None = memory_bytes
        capacity = memory_bytes // BYTES_PER_BLOCK
        self._log_odds = np.zeros((capacity, VOXELS_PER_BLOCK), np.float32)
        self._seen = np.zeros((capacity, VOXELS_PER_BLOCK), np.uint8)
        self._free = np.arange(capacity - 1, -1, -1)
        self._left = capacity
        self._rows: dict[tuple[int, int, int], int] = {}  # of each tile, in the arrays below
        self._tiles = np.zeros((64, 3), np.int32)
        self._exists = np.zeros((64, BLOCKS_PER_TILE), bool)
        self._slots = np.full((64, BLOCKS_PER_TILE), -1, np.int32)  # all -1 if on disk alone
        self._resident = np.zeros(64, bool)
        self._dirty = np.zeros(64, bool)
        self._used = np.zeros(64, np.int64)
        self._clock = self._count = self._bits = 0

    @classmethod
    def new(cls, folder: Path, memory_bytes: int) -> Self:
        """A store without blocks in a folder, which is made if it is not there.

        See `resume` for what it held before.

        Raises:
            MemoryLimitError: The memory is too little.
            MissingExtraError: The package zarr is not installed.
        """
        store = cls(TileFiles(folder), memory_bytes)
        folder.mkdir(exist_ok=True)
        store.files.recover()
        return store

    @classmethod
    def opened(cls, folder: Path, about: About, memory_bytes: int) -> Self:
        """The tiles of a map that was written, to be read as they are needed.

        Raises:
            MapFileError: The file is damaged.
            MemoryLimitError: The memory is too little.
        """
        store = cls(TileFiles(folder, about.first), memory_bytes, writable=False)
        store.recall(about.coords(folder), int(about.bits))
        return store

    def recall(self, coords: Int32, bits: int) -> None:
        """Know of blocks (N, 3) that are on disk, and what their voxels were seen as."""
        tiles, places = places_of(coords)
        rows, which = self._rows_of(tiles, make=True)
        self._exists[rows[which], places] = True
        self._count, self._bits = len(coords), bits

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return self._count

    @property
    def bits(self) -> int:
        """All that any voxel was seen as."""
        held = np.flatnonzero(self._dirty[: len(self._rows)])
        for row in held.tolist():
            self._bits |= _all_bits(self._seen[self._slots_of(row)])
        return self._bits

    @property
    def coords(self) -> Int32:
        """Block indices (blocks, 3), by tile."""
        rows = self._sorted_rows()
        found = [self._blocks_of(row) for row in rows]
        return np.concatenate([np.empty((0, 3), np.int32), *found])

    @property
    def log_odds(self) -> Float32:
        """Refused: they may be more than memory holds."""
        raise _whole()

    @property
    def seen(self) -> Array:
        """Refused: they may be more than memory holds."""
        raise _whole()

    def allocate(self, coords: Int32) -> Int64:
        """Refused, as there are no rows of all blocks."""
        raise _whole()

    def find(self, coords: Int32) -> Int64:
        """Refused, as there are no rows of all blocks."""
        raise _whole()

    def hold(self, coords: Int32) -> Held:
        """Distinct blocks (N, 3) to be written, making those that are new, all zeros.

        Raises:
            MemoryLimitError: They alone are more than the store's memory.
            TypeError: The map was opened to be read.
        """
        if not self._writable:
            raise TypeError("a map that is read from its file as needed cannot be written")
        tiles, places = places_of(coords)
        rows, which = self._rows_of(tiles, make=True)
        at = rows[which]
        new = np.flatnonzero(~self._exists[at, places])
        self._bring(rows, len(new))
        if len(new):
            fresh = self._take(len(new))
            self._log_odds[fresh], self._seen[fresh] = 0.0, 0
            self._slots[at[new], places[new]] = fresh
            self._exists[at[new], places[new]] = True
            self._count += len(new)
        self._dirty[rows] = True
        return Held(self._slots[at, places].astype(np.int64), self._log_odds, self._seen)

    def read(self, coords: Int32) -> Blocks:
        """Copies of blocks (N, 3); zeros for those that do not exist."""
        tiles, places = places_of(coords)
        rows, which = self._rows_of(tiles, make=False)
        log_odds = np.zeros((len(coords), VOXELS_PER_BLOCK), np.float32)
        seen = np.zeros((len(coords), VOXELS_PER_BLOCK), np.uint8)
        for number, row in enumerate(rows):
            if row < 0:
                continue
            here = np.flatnonzero(which == number)
            here = here[self._exists[row, places[here]]]
            self._bring(np.array([row]), 0)
            slots = self._slots[row, places[here]]
            log_odds[here], seen[here] = self._log_odds[slots], self._seen[slots]
        return Blocks(coords, log_odds, seen)

    def parts(self, touches: Touches | None = None, order: Order = "any") -> Iterator[Blocks]:
        """All blocks, or those of interest, tile by tile; ascending, by columns of tiles."""
        rows = self._sorted_rows()
        if touches is not None:
            rows = rows[touches(self._tiles[rows], TILE)]
        groups = self._columns(rows) if order == "ascending" else ((row, None) for row in rows)
        for group, layer in groups:
            part = self._part(np.atleast_1d(group), layer, touches)
            if len(part.coords):
                yield part

    def flush(self, also: Iterable[str] = ()) -> None:
        """Write what is in memory and not on disk; see `TileFiles.commit`."""
        self._write(np.flatnonzero(self._dirty[: len(self._rows)]))
        self.files.commit(also)

    def keep(self, **arrays: Array) -> None:
        """Flush, together with arrays that tell what is in the map; `resume` gives them back."""
        path = self.files.folder / f"{CHECKPOINT}.new"
        with path.open("wb") as file:
            np.savez(
                file, coords=self.coords, bits=np.array(self.bits), allow_pickle=False, **arrays
            )
        self.flush([CHECKPOINT])

    def resume(self) -> dict[str, Array] | None:
        """Know of what was there at the last `keep`; without one, let go of all that is there."""
        path = self.files.folder / CHECKPOINT
        if not path.is_file():
            self.files.clear()
            return None
        with np.load(path, allow_pickle=False) as archive:
            arrays = dict(archive)
        self.recall(arrays["coords"], int(arrays["bits"]))
        return arrays

    def settle(self, voxel_m: float, origin_m: tuple[float, float, float]) -> None:
        """Flush, and make the folder a map that others open; the store can then be read alone."""
        coords = self.coords
        self.flush()
        (self.files.folder / CHECKPOINT).unlink(missing_ok=True)
        filled = self._exists[: len(self._rows)].any(axis=1)
        self.files.settle(self._tiles[: len(self._rows)][filled])
        describe(self.files.folder, coords, self.files.first, voxel_m, origin_m, self.bits)
        self._writable = False

    def _rows_of(self, tiles: Int32, *, make: bool) -> tuple[Int64, Int64]:
        """Rows of the distinct ones of tiles (N, 3), -1 if there is none, and which each is."""
        keys, first, which = np.unique(
            tiles.astype(np.int64) @ _KEY, return_index=True, return_inverse=True
        )
        rows = np.empty(len(keys), np.int64)
        for number, (x, y, z) in enumerate(tiles[first].tolist()):
            row = self._rows.get((x, y, z), -1)
            if row < 0 and make:
                row = self._rows[x, y, z] = len(self._rows)
                self._grow(row)
                self._tiles[row] = x, y, z
            rows[number] = row
        return rows, which.reshape(-1)

    def _grow(self, row: int) -> None:
        if row < len(self._tiles):
            return
        for name, nothing in _TABLES.items():
            old = getattr(self, name)
            new = np.full((2 * len(old), *old.shape[1:]), nothing, old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)

    def _bring(self, rows: Int64, more: int) -> None:
        """Have tiles in memory, and room for more blocks.

        Raises:
            MemoryLimitError: They are more than the memory.
        """
        self._clock += 1
        self._used[rows] = self._clock
        absent = rows[~self._resident[rows]]
        needed = int(self._exists[absent].sum()) + more
        if needed > self._left:
            self._make_room(needed, rows)
        for row in absent:
            places = np.flatnonzero(self._exists[row])
            if len(places):
                log_odds, seen = self.files.read(self._tiles[row])
                slots = self._take(len(places))
                self._log_odds[slots], self._seen[slots] = log_odds[places], seen[places]
                self._slots[row, places] = slots
            self._resident[row] = True

    def _make_room(self, needed: int, kept: Int64) -> None:
        """Write tiles, and let go of them, the one longest unused first."""
        resident = np.flatnonzero(self._resident[: len(self._rows)])
        others = np.setdiff1d(resident, kept)
        others = others[np.argsort(self._used[others], kind="stable")]
        room = self._left + np.cumsum(self._exists[others].sum(axis=1))
        if needed > (room[-1] if len(room) else self._left):
            raise MemoryLimitError(
                f"--memory: what is looked at at once takes more than the "
                f"{len(self._log_odds) * BYTES_PER_BLOCK / 1e6:.3g} MB that are given; give more, "
                "or take larger voxels (--voxel)"
            )
        wanted = min(needed + int(_SPARE * len(self._log_odds)), int(room[-1]))
        going = others[: int(np.searchsorted(room, wanted)) + 1]
        self._write(going[self._dirty[going]])
        for row in going:
            slots = self._slots_of(row)
            self._free[self._left : self._left + len(slots)] = slots
            self._left += len(slots)
            self._slots[row] = -1
        self._resident[going] = False

    def _take(self, count: int) -> Int64:
        self._left -= count
        return self._free[self._left : self._left + count].copy()

    def _write(self, rows: Int64) -> None:
        for start in range(0, len(rows), _AT_ONCE):
            self.files.write(self._whole(row) for row in rows[start : start + _AT_ONCE])
        self._dirty[rows] = False

    def _whole(self, row: int) -> tuple[Int32, Float32, Array]:
        """A tile with all of its 512 places."""
        log_odds = np.zeros((BLOCKS_PER_TILE, VOXELS_PER_BLOCK), np.float32)
        seen = np.zeros((BLOCKS_PER_TILE, VOXELS_PER_BLOCK), np.uint8)
        places, slots = np.flatnonzero(self._exists[row]), self._slots_of(row)
        log_odds[places], seen[places] = self._log_odds[slots], self._seen[slots]
        self._bits |= _all_bits(seen)
        return self._tiles[row], log_odds, seen

    def _slots_of(self, row: int) -> Int64:
        slots: Int64 = self._slots[row, self._exists[row]]
        return slots

    def _blocks_of(self, row: int) -> Int32:
        return blocks_of(self._tiles[row], np.flatnonzero(self._exists[row]))

    def _sorted_rows(self) -> Int64:
        return np.lexsort(self._tiles[: len(self._rows)].T[::-1])

    def _columns(self, rows: Int64) -> Iterator[tuple[Int64, int]]:
        """Rows of tiles above each other, for each layer of blocks in x, so that blocks ascend."""
        x, y, _ = self._tiles[rows].T
        for slab in np.unique(x):
            for layer in range(TILE):
                for column in np.unique(y[x == slab]):
                    yield rows[(x == slab) & (y == column)], layer

    def _part(self, rows: Int64, layer: int | None, touches: Touches | None) -> Blocks:
        """Some blocks of some tiles, by x, y, z."""
        self._bring(rows, 0)
        coords = np.concatenate([self._blocks_of(row) for row in rows])
        slots = np.concatenate([self._slots_of(row) for row in rows])
        kept: Bool = np.ones(len(coords), bool)
        if layer is not None:
            kept = (coords[:, 0] & (TILE - 1)) == layer
        if touches is not None:
            kept &= touches(coords, 1)
        coords, slots = coords[kept], slots[kept]
        order = sorting(coords, "ascending")
        coords, slots = coords[order], slots[order]
        return Blocks(coords, self._log_odds[slots], self._seen[slots])


_AT_ONCE = 16
"""Tiles that are written at a time: each takes its memory twice meanwhile."""
_KEY = np.array([1 << 42, 1 << 21, 1])
_TABLES = {
    "_tiles": 0, "_exists": False, "_slots": -1, "_resident": False, "_dirty": False, "_used": 0
}  # fmt: skip


def take_over(before: Path, folder: Path) -> None:
    """Let the tiles in a folder that a process has left be in a new one too.

    A tile's file is replaced and never changed, so that a second name for it is enough.
    """
    for file in [file for file in before.rglob("*") if file.is_file()]:
        place = folder / file.relative_to(before)
        place.parent.mkdir(parents=True, exist_ok=True)
        link(file, place)


def link(file: Path, place: Path) -> None:
    """Give a file another name, or copy it where there are no second names."""
    try:
        os.link(file, place)
    except OSError:
        shutil.copy2(file, place)


def _all_bits(seen: Array) -> int:
    return int(np.bitwise_or.reduce(seen, axis=None, initial=0))


def _whole() -> MemoryLimitError:
    return MemoryLimitError(
        "this map is kept on disk, and all of it at once may be more than memory holds; go by "
        "VoxelMap.parts, select, read or window, or leave --memory out"
    )
