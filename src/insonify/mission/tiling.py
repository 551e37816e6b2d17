"""A map made by a cluster: the area in parts, each mapped by a worker from all that reaches it.

What `bayes` makes of a block depends on the pings that reach it and on their order alone, so that
a worker that goes through all pings in order, and maps those of its part, makes of it what one
process would have made.  Parts are whole tiles, and each worker writes those of its own.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import ConfigError, InsonifyError
from insonify.frames import world_from_sonar
from insonify.io.maps.ondisk import TileStore
from insonify.io.maps.tiles import TileFiles
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, Recording
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.factory import make_mapper
from insonify.mapping.fan import block_span, fan_box
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.store import TILE
from insonify.mapping.voxels import FARTHEST_BLOCK, VoxelMap
from insonify.mission.cluster import Cluster
from insonify.mission.crew import Failure
from insonify.mission.remap import Remap, Watch, go_through, moved, settle_region
from insonify.types import Array, Box, FanGeometry, Float32, Float64, Int32, Int64, Ping, Pose

MEMORY_BYTES = 500_000_000
"""Of a worker, where nothing is said."""
PARTS_PER_THREAD = 2
"""More parts than threads, so that none waits long for the last."""


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be mapped, and how.

    Attributes:
        files: The recordings, in order, where the workers find them too.
        reading: What the user says of them.
        mapper: Its name.
        settings: Its settings.
        options: Of a user's own mapper.
        folder: The map's, where the workers find it too.
        memory_bytes: What the blocks of a worker may take in memory.
    """

    files: tuple[Path, ...]
    reading: Reading
    mapper: str
    settings: MappingSettings
    options: Mapping[str, Any]
    folder: Path
    memory_bytes: int


@dataclass(frozen=True, slots=True)
class Part:
    """What a worker does: the tiles from one column to another (x, y), both included."""

    order: Order
    origin_m: tuple[float, float, float]
    low: tuple[int, int]
    high: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class PartMapped:
    """What a worker has written: its blocks (N, 3), and what their voxels were seen as."""

    coords: Int32
    bits: int


def map_on_cluster(
    order: Order,
    recordings: Sequence[Recording],
    address: str,
    region: Box | None = None,
    *,
    watch: Watch = lambda remap, recording, number, posed: None,
    told: Callable[[int, int], None] = lambda done, parts: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Remap | None:
    """Map recordings with the workers of a Dask cluster that runs already.

    Args:
        order: What and how.
        recordings: Those of its files.
        address: The scheduler's.
        region: Where entropy is counted; by default around the occupied voxels.
        watch: Called after each ping whose reach is looked up, as in `map_recordings`.
        told: Called with how many parts are done, and how many there are.
        should_stop: Asked again and again; if true, nothing comes of it.

    Returns:
        The map, on disk, and what went into it; None if it was stopped.

    Raises:
        ConfigError: The mapper cannot be had in parts.
        ClusterError: There is no such cluster, it is lost, or a part could not be mapped.
        RecordingError: A recording has no pose for any of its pings.
    """
    mapper = _mapper(order)
    with Cluster(address, map_part, "a map on a cluster") as crew:
        reach = _Reach(mapper.name, order.settings)
        remap = Remap(order.settings, reach)
        go_through(remap, recordings, watch, should_stop)
        origin_m = reach.voxels.origin_m
        parts = [
            Part(order, origin_m, low, high)
            for low, high in divided(reach.columns, PARTS_PER_THREAD * crew.threads)
        ]
        order.folder.mkdir()
        since = time.perf_counter()
        mapped = _all_mapped(parts, crew, told, should_stop)
        remap.seconds["mapping"] += time.perf_counter() - since
    if mapped is None or should_stop():
        return None
    mapper.voxels = VoxelMap(order.settings.voxel_m, _joined(order, mapped), origin_m)
    remap.mapper = mapper
    settle_region(remap, region)
    return remap


def _joined(order: Order, mapped: Sequence[PartMapped]) -> TileStore:
    """A store of what the workers have written."""
    store = TileStore(TileFiles(order.folder), order.memory_bytes)
    none = np.empty((0, 3), np.int32)
    bits = int(np.bitwise_or.reduce([part.bits for part in mapped], initial=0))
    store.recall(np.concatenate([none, *(part.coords for part in mapped)]), bits)
    return store


def _all_mapped(
    parts: Sequence[Part],
    crew: Cluster,
    told: Callable[[int, int], None],
    should_stop: Callable[[], bool],
) -> list[PartMapped] | None:
    waiting, done = deque(enumerate(parts)), list[PartMapped]()
    while len(done) < len(parts):
        if should_stop():
            return None
        while waiting and crew.room() > 0:
            number, part = waiting.popleft()
            crew.take((number, 0), part)
        for _, outcome in crew.landed():
            if isinstance(outcome, Failure):
                raise outcome.error()
            done.append(outcome)
        told(len(done), len(parts))
    return done


def map_part(part: Part) -> PartMapped | Failure:
    """On a worker: map what reaches a part of the area."""
    order = part.order
    try:
        if not order.folder.is_dir():
            raise ConfigError(
                f"{order.folder}: the workers do not see this folder; recordings and results must "
                "lie where they find them under the same names"
            )
        name = "part-{}-{}".format(*part.low)
        (order.folder / f"{name}.txt").unlink(missing_ok=True)  # of a worker that was killed
        store = TileStore(TileFiles(order.folder, name=name), order.memory_bytes)
        mapper = _mapper(order)
        mapper.voxels = VoxelMap(order.settings.voxel_m, store, part.origin_m)
        up = FARTHEST_BLOCK
        mapper.within = (
            np.array([*(TILE * low for low in part.low), -up], np.int32),
            np.array([*(TILE * high + TILE - 1 for high in part.high), up], np.int32),
        )
        for file in order.files:
            for told in open_recording(file, order.reading):
                posed = moved(told, part.origin_m)
                if posed.pose is not None:
                    mapper.integrate(posed.ping, posed.pose)
            mapper.finish_scan()
        store.flush()
    except InsonifyError as err:
        return Failure(str(err))
    return PartMapped(store.coords, store.bits)


def divided(
    columns: Mapping[tuple[int, int], int], count: int
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Rectangles of tiles (x, y) with about as many visits each: first and last column.

    Args:
        columns: How many pings reach each column of tiles.
        count: How many rectangles there should be at most.
    """
    if not columns:
        return []
    places = np.array(list(columns), np.int64)
    visits = np.array(list(columns.values()), np.float64)
    found, queue = [], [(places, visits, count)]
    while queue:
        places, visits, count = queue.pop()
        low, high = places.min(axis=0), places.max(axis=0)
        axis = int(np.argmax(high - low))
        if count < 2 or low[axis] == high[axis]:
            x0, y0, x1, y1 = map(int, (*low, *high))
            found.append(((x0, y0), (x1, y1)))
            continue
        before = _split(places[:, axis], visits, (count // 2) / count)
        queue.append((places[before], visits[before], count // 2))
        queue.append((places[~before], visits[~before], count - count // 2))
    return sorted(found)


def _split(along: Int64, visits: Float64, share: float) -> Array:
    """Which places lie before a cut that leaves about a share of the visits there; some on both."""
    at = np.unique(along)
    sums = np.cumsum([visits[along == place].sum() for place in at])
    cut = at[int(np.argmin(np.abs(sums[:-1] - share * sums[-1])))]
    return np.asarray(along <= cut)


def _mapper(order: Order) -> BayesMapper:
    mapper = make_mapper(order.mapper, order.settings, order.options)
    if not isinstance(mapper, BayesMapper):
        raise ConfigError(
            f"mapper {mapper.name!r} cannot map a part of the area alone; leave --scheduler out, "
            "or give --mapper bayes"
        )
    return mapper


@dataclass(slots=True)
class _Reach:
    """Maps nothing, but notes how many pings reach each column of tiles (a `Mapper`)."""

    name: str
    settings: MappingSettings
    columns: Counter[tuple[int, int]] = field(default_factory=Counter)
    voxels: VoxelMap = field(init=False)

    def __post_init__(self) -> None:
        self.voxels = VoxelMap(self.settings.voxel_m)

    def integrate(self, ping: Ping, pose: Pose) -> None:
        geometry = ping.geometry
        box = fan_box(world_from_sonar(pose, geometry.mount), geometry)
        low, high = (corner // TILE for corner in block_span(box, self.voxels.block_m))
        x, y = (np.arange(low[axis], high[axis] + 1) for axis in (0, 1))
        self.columns.update((i, j) for i in x.tolist() for j in y.tolist())

    def finish_scan(self) -> None:
        pass

    def tells(self, poses: Sequence[Pose], geometry: FanGeometry, voxels_m: Float64) -> Float32:
        raise NotImplementedError

    def save(self) -> dict[str, Array]:
        return {}

    def load(self, arrays: Mapping[str, Array]) -> None:
        raise NotImplementedError
