"""What one ping does to a few voxels, told by the map itself."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from insonify.mapping.store import BLOCK, cell_of
from insonify.types import Array, Float32, Int32, Int64


class _Blocks(Protocol):
    @property
    def log_odds(self) -> Float32: ...

    @property
    def seen(self) -> Array: ...

    def find(self, coords: Int32) -> Int64: ...


class Witness:
    """Wipes bits of some voxels before a ping, so that those found after it are the ping's own.

    No update asks for the bits that are wiped, so it does what it would have done.  They are told
    also where the log-odds cannot change any more, at a clamp.
    """

    def __init__(self, blocks: _Blocks, voxels: Int64, bits: int) -> None:
        """Take note of voxels before a ping.

        Args:
            blocks: A map, or what keeps its blocks.
            voxels: (N, 3) indices.
            bits: Those of ``seen`` that are wiped.
        """
        self._blocks, self._coords = blocks, (voxels // BLOCK).astype(np.int32)
        self._cells, self._bits = cell_of(voxels), bits
        slots, there = self._places()
        self.log_odds = np.zeros(len(voxels), np.float32)
        self._seen = np.zeros(len(voxels), np.uint8)
        self.log_odds[there] = blocks.log_odds[slots, self._cells[there]]
        self._seen[there] = blocks.seen[slots, self._cells[there]]
        blocks.seen[slots, self._cells[there]] &= np.uint8(0xFF ^ bits)

    def dismiss(self) -> Array:
        """Put back what was wiped; the bits (N,) that the ping has set."""
        found = np.zeros(len(self._cells), np.uint8)
        slots, there = self._places()
        cells = self._cells[there]
        found[there] = self._blocks.seen[slots, cells] & self._bits
        self._blocks.seen[slots, cells] |= self._seen[there]
        return found

    def _places(self) -> tuple[Int64, Int64]:
        """Slots of those voxels whose blocks there are, and which these are."""
        slots = self._blocks.find(self._coords)
        there = np.flatnonzero(slots >= 0)
        return slots[there], there
