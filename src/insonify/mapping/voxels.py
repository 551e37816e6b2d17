"""A 3D occupancy map made of blocks of voxels, which grows where the vehicle goes.

Each voxel holds its occupancy as log-odds (0 is p = 0.5) and facts about its past: whether it has
been inside a sonar's field of view, whether any echo or silence spoke about it, and, from mappers
that tell, whether the surface of an object passes through it.  A
voxel's indices are ``floor(position / voxel_m)`` in the world frame; a block is 8 x 8 x 8 voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from insonify import memory
from insonify.display import Told
from insonify.errors import MemoryLimitError
from insonify.extras import optional
from insonify.mapping.store import (
    BLOCK,
    BYTES_PER_VOXEL,
    VOXELS_PER_BLOCK,
    BlockStore,
    MemoryStore,
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
    "OBSERVED",
    "SURFACE",
    "VOXELS_PER_BLOCK",
    "VoxelMap",
    "VoxelWindow",
    "probability_from_log_odds",
    "surface_of",
    "touching",
]

FARTHEST_BLOCK = 1_000_000
IN_VIEW = 1
OBSERVED = 2
SURFACE = 4
_DENSE_BYTES = 17
"""Of a voxel in `VoxelMap.to_xarray`, while it is made."""


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


class VoxelMap(Told):
    """Blocks of voxels, allocated when first touched.

    Attributes:
        voxel_m: Edge length of a voxel.
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
        self._store: BlockStore = MemoryStore() if store is None else store

    @property
    def block_count(self) -> int:
        """How many blocks are allocated."""
        return len(self._store.coords)

    @property
    def block_m(self) -> float:
        """Edge length of a block."""
        return BLOCK * self.voxel_m

    @property
    def coords(self) -> Int32:
        """Block indices (blocks, 3), in order of allocation."""
        return self._store.coords

    @property
    def log_odds(self) -> Float32:
        """Log-odds of all voxels, (blocks, 512), x outermost; a view, so kernels may write it."""
        return self._store.log_odds

    @property
    def seen(self) -> np.ndarray:
        """IN_VIEW and OBSERVED bits of all voxels, (blocks, 512) uint8; a view."""
        return self._store.seen

    @property
    def marked(self) -> bool:
        """Whether the mapper tells surface from solid."""
        return bool((self.seen & SURFACE).any())

    @property
    def surface(self) -> Bool:
        """Voxels that the surface of an object passes through, (blocks, 512); see `surface_of`."""
        return surface_of(self.log_odds, self.seen, self.marked)

    def allocate(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3), making those that are new."""
        return self._store.allocate(coords)

    def find(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3); -1 for blocks that do not exist."""
        return self._store.find(coords)

    def at(self, voxel: tuple[int, int, int]) -> tuple[float, int]:
        """Log-odds and the bits of what was seen of a voxel by its index; 0, 0 if it has none."""
        index = np.asarray(voxel)
        slot = int(self.find((index // BLOCK).astype(np.int32)[None])[0])
        if slot < 0:
            return 0.0, 0
        cell = cell_of(index)
        return float(self.log_odds[slot, cell]), int(self.seen[slot, cell])

    def occupied_m(self, box: Box | None = None) -> Float64:
        """Centres (N, 3) of voxels more likely occupied than not, world frame.

        Args:
            box: Only those of the blocks that touch it are looked at; by default all.
        """
        coords, log_odds = self.coords, self.log_odds
        if box is not None:
            near = touching(coords, self.block_m, box)
            coords, log_odds = coords[near], log_odds[near]
        row, voxel = np.nonzero(log_odds > 0.0)
        within = np.column_stack(np.unravel_index(voxel, (BLOCK, BLOCK, BLOCK)))
        index = coords[row] * BLOCK + within
        return (index.astype(np.float64) + 0.5) * self.voxel_m

    def around_occupied(self) -> Box:
        """The occupied voxels and a block around them; all of the map if none is occupied.

        An empty map gives the block at the origin.
        """
        occupied = self.occupied_m()
        if len(occupied):
            return Box.of(occupied.min(axis=0), occupied.max(axis=0)).grown(self.block_m)
        coords = self.coords if self.block_count else np.zeros((1, 3), np.int32)
        low, high = coords.min(axis=0), coords.max(axis=0) + 1
        return Box.of(low * self.block_m, high * self.block_m)

    def window(self, box: Box) -> VoxelWindow:
        """A dense copy of the voxels whose centres lie in a box."""
        low = np.ceil(np.asarray(box.low_m) / self.voxel_m - 0.5 - 1e-9).astype(int)
        high = np.floor(np.asarray(box.high_m) / self.voxel_m - 0.5 + 1e-9).astype(int) + 1
        shape = tuple(np.maximum(high - low, 0).tolist())
        log_odds = np.zeros(shape, np.float32)
        seen = np.zeros(shape, np.uint8)
        if 0 not in shape:
            self._copy_blocks(low, high, log_odds, seen)
        first = (int(low[0]), int(low[1]), int(low[2]))
        return VoxelWindow(first, self.voxel_m, log_odds, seen, self.marked)

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
        needed = _DENSE_BYTES * float(np.prod(np.divide(box.size_m, self.voxel_m)))
        if not memory.fits(needed):
            raise MemoryLimitError(
                f"a dense copy of {' x '.join(f'{size:.3g}' for size in box.size_m)} m in voxels "
                f"of {self.voxel_m:g} m would need {memory.shortage(needed)}; give a smaller box"
            )
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

    def _copy_blocks(
        self, low: np.ndarray, high: np.ndarray, log_odds: Float32, seen: np.ndarray
    ) -> None:
        corners = self.coords * BLOCK
        touching = ((corners < high) & (corners + BLOCK > low)).all(axis=1)
        for slot in np.flatnonzero(touching):
            start = np.maximum(corners[slot], low)
            stop = np.minimum(corners[slot] + BLOCK, high)
            inside = tuple(map(slice, start - corners[slot], stop - corners[slot]))
            target = tuple(map(slice, start - low, stop - low))
            log_odds[target] = self.log_odds[slot].reshape(BLOCK, BLOCK, BLOCK)[inside]
            seen[target] = self.seen[slot].reshape(BLOCK, BLOCK, BLOCK)[inside]


def surface_of(log_odds: Float32, seen: np.ndarray, marked: bool) -> Bool:
    """Voxels that the surface of an object passes through, any shape.

    Those that the mapper has marked; a mapper that marks none in all the map, as the papers' does,
    makes no difference between surface and what is occupied.
    """
    surface: Bool = (seen & SURFACE) > 0 if marked else log_odds > 0.0
    return surface


def touching(coords: Int32, block_m: float, box: Box) -> Bool:
    """Which blocks (N, 3) a box touches."""
    low_m = coords.astype(np.float64) * block_m
    inside = (low_m <= box.high_m) & (low_m + block_m >= box.low_m)
    return np.asarray(inside.all(axis=1), bool)


def probability_from_log_odds(log_odds: Float32) -> Float32:
    """P = 1 / (1 + exp(-l)), any shape."""
    return (1.0 / (1.0 + np.exp(-log_odds))).astype(np.float32)
