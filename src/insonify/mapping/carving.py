"""Carving: a map by visibility, with the seabed.

Where `bayes` counts echoes for the whole arc of a pixel, this mapper asks what can be seen: voxels
are cut away by rays that are shown to have passed (`insonify.mapping.visibility`), and what is
left over is the object.  Inside it works on voxels a part as large.  What is told of the map's own
voxels is looked up in a table learned from objects whose shape is known
(`insonify.mapping.odds`), so that its probabilities are calibrated.

Nothing of it is from Park et al.; the Bayes update is `insonify.mapping.bayes`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from insonify.errors import ConfigError
from insonify.frames import world_from_sonar
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.fan import blocks_in_fan, fan_vector
from insonify.mapping.mapper import MappingSettings, Shown
from insonify.mapping.odds import DOUBTED, Evidence, odds_table, read_off
from insonify.mapping.seabed import SeabedHeights
from insonify.mapping.sight import before_the_first_occupied
from insonify.mapping.store import (
    BLOCK,
    VOXELS_PER_BLOCK,
    Blocks,
    Held,
    MemoryStore,
    Order,
    Touches,
)
from insonify.mapping.visibility import EVER_LIT, LOOKED_AT, ROWS, count_pixels, look, vote
from insonify.mapping.voxels import VoxelMap
from insonify.mapping.witness import Witness
from insonify.types import (
    Array,
    Bool,
    FanGeometry,
    Float32,
    Float64,
    Int32,
    Int64,
    Ping,
    Pose,
)

_KNOWN_FREE = -1.5
"""Log-odds below which a lit voxel does not stop a ray: two pings have shown it free."""
_DARK, _LIT = -1.0, 0.1
"""Votes of a voxel that a ray passes, and of one that is lit or stops it."""
_LIMITS = np.array([-6.0, 6.0], np.float32)
_ZONE_M = 0.1
"""Rays end so far above the seabed."""
_CERTAIN = 5.0
"""Points near a place that make the seabed's height there good enough to judge shadows by."""
_DOUBT_M = 0.15
"""How much lower the seabed is taken to be where it is not."""
_NOWHERE_M = -1e9
_SPAN = 1 << 22
"""More than the blocks across any map."""
_MOST_STD_M = 0.15
"""A pose that may be farther off counts as if it were not: something must count."""
_SLACK = 0.3
"""Of a standard deviation."""
_APART = 1.0, 1.5
"""Rays lie so many voxels apart at the end of the range: in elevation, and at most in azimuth."""


class CarvingMapper:
    """A mapper that cuts away what is shown to be free."""

    name = "carving"

    def __init__(self, settings: MappingSettings) -> None:
        """An empty map."""
        self.settings = settings
        self._voxel_m = settings.voxel_m / settings.carving.inside
        self._papers = BayesMapper(settings)
        self._fine = MemoryStore()
        self._seabed = SeabedHeights()
        self._marks = np.zeros((ROWS, 0, VOXELS_PER_BLOCK), np.uint8)
        self._derived = _Derived(settings.carving.inside, self._fine, self._papers.voxels)
        self.voxels = VoxelMap(settings.voxel_m, self._derived)

    def integrate(self, ping: Ping, pose: Pose) -> None:
        """Cut away what a ping shows to be free."""
        self._papers.integrate(ping, pose)
        geometry = ping.geometry
        transform = world_from_sonar(pose, geometry.mount)
        threshold = np.float32(self.settings.pixel_threshold / 255.0)
        self._seabed.hear(ping.image, float(threshold), transform, geometry)
        blocks = blocks_in_fan(transform, geometry, BLOCK * self._voxel_m)
        slots = self._fine.allocate(blocks)
        std_m = _std(pose, transform, blocks, BLOCK * self._voxel_m)
        views = _views(transform, blocks, BLOCK * self._voxel_m, std_m > self._voxel_m / 2)
        self._derived.touch(blocks, slots, views)
        if len(blocks) > self._marks.shape[1]:
            self._marks = np.zeros((ROWS, len(blocks) * 5 // 4, VOXELS_PER_BLOCK), np.uint8)
        first = blocks.min(axis=0).astype(np.int64)
        index = np.full(tuple(blocks.max(axis=0) + 1 - first), -1, np.int32)
        index[tuple((blocks - first).T)] = np.arange(len(blocks))
        look(
            index,
            first,
            slots,
            self._fine.log_odds,
            self._fine.seen,
            transform,
            fan_vector(geometry),
            _rays(geometry, self._voxel_m),
            self._voxel_m,
            count_pixels(ping.image, threshold, *_slack(pose, geometry)),
            self._seabed_under(first, index.shape),
            _KNOWN_FREE,
            self._marks,
        )
        votes = _votes(std_m, self._voxel_m)
        vote(slots, self._fine.log_odds, self._fine.seen, self._marks, votes, _LIMITS)

    def explain(self, ping: Ping, pose: Pose, voxel: tuple[int, int, int]) -> Shown:
        """Cut away, and tell what the ping showed of the voxels inside one (an `Explains`)."""
        inside = self.settings.carving.inside
        parts = np.array(voxel) * inside + np.indices((inside,) * 3).reshape(3, -1).T
        witness = Witness(self._fine, parts, LOOKED_AT | EVER_LIT)
        self.integrate(ping, pose)
        told = witness.dismiss()
        lit, looked_at = ((told & bit > 0).sum() for bit in (EVER_LIT, LOOKED_AT))
        return Shown(int(lit), int(looked_at - lit), len(parts), self._derived.read_one(voxel))

    def finish_scan(self) -> None:
        """Nothing: every ping has been used when it came."""

    def tells(self, poses: Sequence[Pose], geometry: FanGeometry, voxels_m: Float64) -> Float32:
        """1 for a voxel before the first occupied one of its beam, else 0 (M_b of eq. 6)."""
        return before_the_first_occupied(self.voxels, poses, geometry, voxels_m)

    def save(self) -> dict[str, Array]:
        """The voxels inside, the papers' map, and the seabed."""
        papers = self._papers.voxels
        return {
            "inside": np.array(self.settings.carving.inside),
            **_sorted("fine", self._fine, views=self._derived.views),
            **_sorted("papers", papers),
            **self._seabed.save(),
        }

    def load(self, arrays: Mapping[str, Array]) -> None:
        """Go on from what `save` gave.

        Raises:
            ConfigError: It is of an earlier version, or had other voxels inside.
        """
        if "fine_views" not in arrays:
            raise ConfigError("the map to go on with is of an earlier `carving`; map it again")
        inside = self.settings.carving.inside
        if int(arrays["inside"]) != inside:
            raise ConfigError(
                f"mapping.carving.inside is {inside}, and the map to go on with has "
                f"{int(arrays['inside'])}; give it the same"
            )
        coords = np.asarray(arrays["fine_coords"], np.int32)
        slots = self._fine.allocate(coords)
        self._fine.log_odds[slots] = arrays["fine_log_odds"]
        self._fine.seen[slots] = arrays["fine_seen"]
        self._derived.touch(coords, slots, arrays["fine_views"])
        papers = self._papers.voxels
        slots = papers.allocate(np.asarray(arrays["papers_coords"], np.int32))
        papers.log_odds[slots], papers.seen[slots] = (
            arrays["papers_log_odds"],
            arrays["papers_seen"],
        )
        self._seabed.load(arrays)

    def _seabed_under(self, first: Int64, shape: tuple[int, ...]) -> tuple[Float64, Bool, float]:
        """The seabed under the columns of a box of blocks, as `look` takes it."""
        block_m = BLOCK * self._voxel_m
        x_m = (first[0] + np.arange(shape[0]) + 0.5) * block_m
        y_m = (first[1] + np.arange(shape[1]) + 0.5) * block_m
        known = self._seabed.heights(x_m, y_m)
        if known is None:
            return np.full(shape[:2], _NOWHERE_M), np.zeros(shape[:2], bool), _ZONE_M
        heights, points = known
        certain = points >= _CERTAIN
        return np.where(certain, heights, heights - _DOUBT_M), certain, _ZONE_M


def _slack(pose: Pose, geometry: FanGeometry) -> tuple[int, int]:
    """Bins and beams by which an echo may lie beside where its cause is seen to be."""
    position_std_m, attitude_std_rad = pose.std
    middle_m = 0.5 * geometry.range_max_m
    aside_rad = math.hypot(attitude_std_rad, position_std_m / middle_m)
    bins = min(position_std_m, _MOST_STD_M) * _SLACK / geometry.bin_m
    beams = min(aside_rad, _MOST_STD_M / middle_m) * _SLACK / geometry.beam_rad
    return round(bins), round(beams)


def _std(pose: Pose, transform: Float64, blocks: Int32, block_m: float) -> Float64:
    """How far blocks (N, 3) may be from where a pose makes them seem, standard deviations (N,)."""
    position_std_m, attitude_std_rad = pose.std
    away_m = np.linalg.norm((blocks + 0.5) * block_m - transform[:3, 3], axis=1)
    std_m: Float64 = np.hypot(position_std_m, attitude_std_rad * away_m)
    return np.minimum(std_m, _MOST_STD_M)


def _votes(std_m: Float64, voxel_m: float) -> Float32:
    """What a dark and a lit voxel count, (N, 2), in blocks that may be off by so much, (N,).

    The farther they may be from where they seem, the less a ray shows that passed there.
    """
    slower = 1.0 + std_m / voxel_m
    return np.column_stack([_DARK / slower, _LIT * slower]).astype(np.float32)


def _views(transform: Float64, blocks: Int32, block_m: float, doubted: Bool) -> Array:
    """From which of eight sides a ping sees its blocks (N, 3), and which are `DOUBTED`: bits."""
    away = (blocks[:, :2] + 0.5) * block_m - transform[:2, 3]
    side = np.floor(np.arctan2(away[:, 1], away[:, 0]) * (4.0 / math.pi)).astype(np.int64) & 7
    return ((1 << side) | np.where(doubted, DOUBTED, 0)).astype(np.uint16)


def _sorted(name: str, voxels: MemoryStore | VoxelMap, **more: Array) -> dict[str, Array]:
    """A map's arrays, blocks in ascending order."""
    order = np.lexsort(voxels.coords.T[::-1])
    arrays = {"coords": voxels.coords, "log_odds": voxels.log_odds, "seen": voxels.seen, **more}
    return {f"{name}_{key}": array[order] for key, array in arrays.items()}


def _rays(geometry: FanGeometry, voxel_m: float) -> tuple[Float64, Float64]:
    """Azimuths and elevations of rays that leave out no voxel, beam by beam."""
    up, aside = (apart * voxel_m / geometry.range_max_m for apart in _APART)
    each = math.ceil(geometry.beam_rad / aside)
    azimuths = _even(geometry.azimuth_fov_rad, geometry.beams * each)[::-1]
    return np.ascontiguousarray(azimuths), _even(
        geometry.elevation_fov_rad, max(2, math.ceil(geometry.elevation_fov_rad / up))
    )


def _even(extent: float, count: int) -> Float64:
    """Middles of ``count`` equal parts of an extent around 0."""
    return ((np.arange(count) + 0.5) / count - 0.5) * extent


class _Derived:
    """The map's own voxels, read off those inside when they are asked for (a `BlockStore`)."""

    memory_bytes: int | None = None

    def __init__(self, inside: int, fine: MemoryStore, papers: VoxelMap) -> None:
        self._inside, self._fine, self._papers = inside, fine, papers
        self.views = np.zeros(0, np.uint16)
        self._store = MemoryStore()
        self._touched: list[Int64] = []

    def touch(self, blocks: Int32, slots: Int64, views: Array) -> None:
        """Note that blocks (N, 3) inside, at their slots, have changed, with how they were seen."""
        count = len(self._fine.coords)
        if count > len(self.views):
            grown = np.zeros(count * 5 // 4, np.uint16)
            grown[: len(self.views)] = self.views
            self.views = grown
        self.views[slots] |= views
        self._store.allocate(blocks // self._inside)
        columns = (blocks[:, :2] // self._inside).astype(np.int64)
        self._touched.append(np.unique(columns[:, 0] * _SPAN + columns[:, 1]))

    @property
    def coords(self) -> Int32:
        """Block indices (blocks, 3)."""
        return self._store.coords

    @property
    def log_odds(self) -> Float32:
        """(blocks, 512), x outermost."""
        return self._fresh().log_odds

    @property
    def seen(self) -> Array:
        """(blocks, 512) uint8."""
        return self._fresh().seen

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return self._store.count

    @property
    def bits(self) -> int:
        """All that any voxel was seen as."""
        return self._fresh().bits

    def allocate(self, coords: Int32) -> Int64:
        """Refused: these voxels are read off others."""
        raise TypeError("the voxels of a carved map are read off those inside it")

    def hold(self, coords: Int32) -> Held:
        """Refused, as `allocate`."""
        raise TypeError("the voxels of a carved map are read off those inside it")

    def find(self, coords: Int32) -> Int64:
        """Slots of blocks (N, 3); -1 for blocks that do not exist."""
        return self._store.find(coords)

    def read(self, coords: Int32) -> Blocks:
        """Copies of blocks (N, 3); zeros for those that do not exist."""
        return self._fresh().read(coords)

    def parts(self, touches: Touches | None = None, order: Order = "any") -> Iterator[Blocks]:
        """All blocks, or those of interest."""
        return self._fresh().parts(touches, order)

    def read_one(self, voxel: tuple[int, int, int]) -> float:
        """Log-odds of a voxel, of all the map its column of blocks alone read off anew."""
        column = np.array([voxel[:2]], np.int32) // BLOCK
        read_off(self._evidence(), self._store, column, odds_table())
        return VoxelMap(1.0, self._store).at(voxel)[0]

    def _evidence(self) -> Evidence:
        return Evidence(self._inside, self._fine, self.views, self._papers)

    def _fresh(self) -> MemoryStore:
        """The map with all that has changed read off anew."""
        if self._touched:
            keys = np.unique(np.concatenate(self._touched))
            self._touched = []
            around = np.add.outer(np.array([-1, 0, 1]) * _SPAN, np.array([-1, 0, 1])).ravel()
            keys = np.unique(np.add.outer(keys, around))
            y = (keys + _SPAN // 2) % _SPAN - _SPAN // 2
            columns = np.column_stack([(keys - y) // _SPAN, y]).astype(np.int32)
            read_off(self._evidence(), self._store, columns, odds_table())
        return self._store
