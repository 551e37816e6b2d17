"""A 3D occupancy map made of blocks of voxels, which grows where the vehicle goes.

Each voxel holds its occupancy as log-odds (0 is p = 0.5) and facts about its past: whether it has
been inside a sonar's field of view, whether any echo or silence spoke about it, and, from mappers
that tell, whether the surface of an object passes through it.  A
voxel's indices are ``floor(position / voxel_m)`` in the world frame; a block is 8 x 8 x 8 voxels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from insonify import memory
from insonify.display import Told
from insonify.errors import MemoryLimitError
from insonify.extras import optional
from insonify.mapping.extracts import (
    IN_VIEW,
    OBSERVED,
    SURFACE,
    Voxels,
    VoxelWindow,
    copy_blocks,
    picked,
    probability_from_log_odds,
    surface_of,
)
from insonify.mapping.store import (
    BLOCK,
    BYTES_PER_VOXEL,
    VOXELS_PER_BLOCK,
    Blocks,
    BlockStore,
    Held,
    MemoryStore,
    Order,
    cell_of,
)
from insonify.types import Bool, Box, Float32, Float64, Int32, Int64

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

__all__ = [
    "BLOCK",
    "BYTES_PER_VOXEL",
    "FARTHEST_BLOCK",
    "IN_VIEW",
    "MOST_DENSE",
    "OBSERVED",
    "SURFACE",
    "VOXELS_PER_BLOCK",
    "Blocks",
    "VoxelMap",
    "VoxelWindow",
    "Voxels",
    "picked",
    "probability_from_log_odds",
    "surface_of",
    "touching",
]

FARTHEST_BLOCK = 1_000_000
MOST_DENSE = 150_000_000
"""Voxels of a dense copy for pictures."""
_DENSE_BYTES = 24
"""Of a voxel in a window, and in what is commonly made of it."""
_PICKED_BYTES = 128
"""Of a voxel in `VoxelMap.select`, and in what is commonly made of it."""


class VoxelMap(Told):
    """Blocks of voxels, allocated when first touched.

    `parts`, `select`, `count`, `read`, `window` and what builds on them work however large the map
    is; `coords`, `log_odds` and `seen` give all of it at once, and are there only of a map that is
    kept in memory.

    Attributes:
        voxel_m: Edge length of a voxel.
        store: Where its blocks are kept.
        origin_m: Where the map's own frame lies in the world, so that small numbers do for places
            far away: all that a map takes and tells is relative to it.
    """

    def __init__(
        self,
        voxel_m: float,
        store: BlockStore | None = None,
        origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """An empty map, or the map of a store.

        Args:
            voxel_m: Edge length of a voxel.
            store: Where the blocks are kept; in memory by default.
            origin_m: See the attribute.
        """
        if not 0.0 < voxel_m < float("inf"):
            raise ValueError(f"voxel_m must be positive and finite, not {voxel_m}")
        self.voxel_m = voxel_m
        self.origin_m = origin_m
        self.store: BlockStore = MemoryStore() if store is None else store

    @property
    def in_memory(self) -> bool:
        """Whether all of it is kept in memory."""
        return self.store.memory_bytes is None

    @property
    def block_count(self) -> int:
        """How many blocks are allocated."""
        return self.store.count

    @property
    def block_m(self) -> float:
        """Edge length of a block."""
        return BLOCK * self.voxel_m

    @property
    def coords(self) -> Int32:
        """Block indices (blocks, 3), in order of allocation."""
        return self.store.coords

    @property
    def log_odds(self) -> Float32:
        """Log-odds of all voxels, (blocks, 512), x outermost; a view, so kernels may write it."""
        return self.store.log_odds

    @property
    def seen(self) -> np.ndarray:
        """IN_VIEW and OBSERVED bits of all voxels, (blocks, 512) uint8; a view."""
        return self.store.seen

    @property
    def bits(self) -> int:
        """All that any voxel was seen as: IN_VIEW, OBSERVED and SURFACE."""
        return self.store.bits

    @property
    def marked(self) -> bool:
        """Whether the mapper tells surface from solid."""
        return bool(self.bits & SURFACE)

    @property
    def surface(self) -> Bool:
        """Voxels that the surface of an object passes through, (blocks, 512); see `surface_of`."""
        return surface_of(self.log_odds, self.seen, self.marked)

    def allocate(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3), making those that are new."""
        return self.store.allocate(coords)

    def find(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3); -1 for blocks that do not exist."""
        return self.store.find(coords)

    def hold(self, coords: Int32) -> Held:
        """Distinct blocks (N, 3) to be written, making those that are new."""
        return self.store.hold(coords)

    def read(self, coords: Int32) -> Blocks:
        """Copies of blocks (N, 3); zeros for those that do not exist."""
        return self.store.read(coords)

    def parts(self, box: Box | None = None, order: Order = "any") -> Iterator[Blocks]:
        """All blocks, or those that a box touches, as many at a time as memory is given to them.

        They are not to be written, and hold until the next part is asked for.
        """
        if box is None:
            return self.store.parts(None, order)
        block_m = self.block_m
        return self.store.parts(lambda cubes, edge: touching(cubes, edge * block_m, box), order)

    def count(self, pick: Callable[[Blocks], Bool]) -> int:
        """How many voxels are picked, (N, 512) of each part."""
        return sum(int(np.count_nonzero(pick(part))) for part in self.parts())

    def select(
        self, pick: Callable[[Blocks], Bool] = lambda part: part.log_odds > 0.0,
        box: Box | None = None,
    ) -> Voxels:  # fmt: skip
        """The voxels that are picked, by default those more likely occupied than not.

        Args:
            pick: Which voxels (N, 512) of some blocks.
            box: Only the blocks that touch it are looked at; by default all.

        Raises:
            MemoryLimitError: They are too many.
        """
        found: list[Voxels] = []
        for part in self.parts(box):
            found.append(picked(part, pick(part)))
            count = sum(len(some.index) for some in found)
            self._check_memory("so many voxels of this map", float(_PICKED_BYTES * count))
        none = Voxels(np.empty((0, 3), np.int64), np.empty(0, np.float32), np.empty(0, np.uint8))
        if len(found) == 1:
            return found[0]
        found = found or [none]
        return Voxels(
            np.concatenate([some.index for some in found]),
            np.concatenate([some.log_odds for some in found]),
            np.concatenate([some.seen for some in found]),
        )

    def at(self, voxel: tuple[int, int, int]) -> tuple[float, int]:
        """Log-odds and the bits of what was seen of a voxel by its index; 0, 0 if it has none."""
        index = np.asarray(voxel)
        block = self.read((index // BLOCK).astype(np.int32)[None])
        cell = cell_of(index)
        return float(block.log_odds[0, cell]), int(block.seen[0, cell])

    def occupied_m(self, box: Box | None = None) -> Float64:
        """Centres (N, 3) of voxels more likely occupied than not, world frame.

        Args:
            box: Only those of the blocks that touch it are looked at; by default all.

        Raises:
            MemoryLimitError: They are too many.
        """
        return self.centres_m(self.select(box=box))

    def centres_m(self, voxels: Voxels) -> Float64:
        """Centres (N, 3) of voxels, in the map's own frame."""
        return np.asarray((voxels.index + 0.5) * self.voxel_m, np.float64)

    def around_occupied(self) -> Box:
        """The occupied voxels and a block around them; `extent` if none is occupied."""
        corners: list[Int64] = []
        for part in self.parts():
            index = picked(part, part.log_odds > 0.0).index
            if len(index):
                corners += [index.min(axis=0), index.max(axis=0)]
        if not corners:
            return self.extent()
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        return Box.of((low + 0.5) * self.voxel_m, (high + 0.5) * self.voxel_m).grown(self.block_m)

    def extent(self) -> Box:
        """All blocks; of an empty map the block at the origin."""
        coords = self.store.coords if self.block_count else np.zeros((1, 3), np.int32)
        low, high = coords.min(axis=0), coords.max(axis=0) + 1
        return Box.of(low * self.block_m, high * self.block_m)

    def span(self, box: Box) -> tuple[Int64, Int64]:
        """Indices of the voxels whose centres lie in a box: the first, and the first beyond."""
        low = np.ceil(np.asarray(box.low_m) / self.voxel_m - 0.5 - 1e-9).astype(np.int64)
        high = np.floor(np.asarray(box.high_m) / self.voxel_m - 0.5 + 1e-9).astype(np.int64) + 1
        return low, np.maximum(low, high)

    def inside(self, coords: Int32, box: Box) -> Bool:
        """Which voxels (N, 512) of blocks (N, 3) have their centres in a box."""
        low, high = self.span(box)
        along = coords.astype(np.int64)[:, :, None] * BLOCK + np.arange(BLOCK)
        x, y, z = ((along >= low[:, None]) & (along < high[:, None])).transpose(1, 0, 2)
        within = x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]
        return np.asarray(within.reshape(-1, VOXELS_PER_BLOCK), bool)

    def window(self, box: Box) -> VoxelWindow:
        """A dense copy of the voxels whose centres lie in a box.

        Raises:
            MemoryLimitError: It would not fit into free memory.
        """
        low, high = self.span(box)
        self._check_dense(box)
        log_odds = np.zeros(high - low, np.float32)
        seen = np.zeros(high - low, np.uint8)
        if log_odds.size:
            for part in self.parts(box):
                copy_blocks(part, low, high, log_odds, seen)
        first = (int(low[0]), int(low[1]), int(low[2]))
        return VoxelWindow(first, self.voxel_m, log_odds, seen, self.marked)

    def overview(self, box: Box) -> VoxelWindow:
        """The same, coarser where it has more than `MOST_DENSE` voxels, or than memory is given to.

        A voxel of it is then a cube of some blocks, and has the largest log-odds of their voxels,
        and all that was seen of them.
        """
        count = math.prod(size / self.voxel_m for size in box.size_m)
        most = min(MOST_DENSE, (self.store.memory_bytes or math.inf) / _DENSE_BYTES)
        if count <= most:
            return self.window(box)
        blocks = 1
        while count / (BLOCK * blocks) ** 3 > most:
            blocks *= 2
        low, high = self.span(box)
        low, high = low // (BLOCK * blocks), -(-high // (BLOCK * blocks))
        log_odds = np.full(high - low, -np.inf, np.float32)
        seen = np.zeros(high - low, np.uint8)
        for part in self.parts(box):
            cubes = part.coords // blocks - low
            within = ((cubes >= 0) & (cubes < high - low)).all(axis=1)
            at = tuple(cubes[within].T)
            np.maximum.at(log_odds, at, part.log_odds[within].max(axis=1))
            np.bitwise_or.at(seen, at, np.bitwise_or.reduce(part.seen[within], axis=1))
        log_odds[log_odds == -np.inf] = 0.0
        first = (int(low[0]), int(low[1]), int(low[2]))
        return VoxelWindow(first, blocks * self.block_m, log_odds, seen, self.marked)

    def plot(self, axes: Axes | None = None, *, side: str = "above") -> Axes:
        """Draw the occupied voxels that are seen from a side, coloured by how near they are to it.

        Args:
            axes: Where; by default those of a new figure, which notebooks show.
            side: ``above``, ``south`` or ``east``.

        Returns:
            The axes, in metres of the world.

        Raises:
            GeometryError: There is no such side.
            MissingExtraError: matplotlib is not installed.
        """
        return self._plotted(axes, side=side)

    def to_xarray(self, box: Box | None = None) -> Dataset:
        """A dense copy over ``x``, ``y`` and ``z``, the voxels' centres in the world, metres.

        Variables: ``probability`` and ``log_odds``, float32; ``in_view``, ``observed`` and
        ``surface``, bool.

        Args:
            box: Of which voxels, in the map's own frame; by default `around_occupied`.

        Raises:
            MemoryLimitError: It would not fit into free memory.
            MissingExtraError: xarray is not installed.
        """
        xarray = optional("xarray", "datasets", "to_xarray")
        box = self.around_occupied() if box is None else box
        window = self.window(box)
        layers = {
            "probability": (window.probability, "occupancy probability"),
            "log_odds": (window.log_odds, "occupancy as log-odds"),
            "in_view": ((window.seen & IN_VIEW) > 0, "has been inside a fan"),
            "observed": ((window.seen & OBSERVED) > 0, "echo or silence spoke about it"),
            "surface": (window.surface, "an object's surface passes through it"),
        }
        axes = {
            name: (name, (np.arange(size) + first + 0.5) * self.voxel_m + origin, {"units": "m"})
            for name, size, first, origin in zip(
                "xyz", window.log_odds.shape, window.first, self.origin_m, strict=True
            )
        }
        found: Dataset = xarray.Dataset(
            {name: (tuple("xyz"), values, {"long_name": told})
             for name, (values, told) in layers.items()},
            axes,
            {"voxel_m": self.voxel_m, "origin_m": list(self.origin_m)},
        )  # fmt: skip
        return found

    def _check_dense(self, box: Box) -> None:
        size = " x ".join(f"{size:.3g}" for size in box.size_m)
        needed = _DENSE_BYTES * float(np.prod(np.divide(box.size_m, self.voxel_m)))
        self._check_memory(f"{size} m in voxels of {self.voxel_m:g} m", needed)

    def _check_memory(self, what: str, needed: float) -> None:
        """Refuse what would not fit into free memory, or that which the map is given."""
        limit = self.store.memory_bytes
        if limit is not None and needed > limit:
            short = f"about {needed / 1e6:.3g} MB, and --memory gives {limit / 1e6:.3g} MB"
        elif not memory.fits(needed):
            short = memory.shortage(needed)
        else:
            return
        raise MemoryLimitError(f"{what} would need {short}; give a smaller box (--region)")


def touching(coords: Int32, block_m: float, box: Box) -> Bool:
    """Which blocks (N, 3) a box touches."""
    low_m = coords.astype(np.float64) * block_m
    inside = (low_m <= box.high_m) & (low_m + block_m >= box.low_m)
    return np.asarray(inside.all(axis=1), bool)
