"""A map made again from recordings: the mapper fed with pings that others recorded."""

from __future__ import annotations

import itertools
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from insonify import memory
from insonify.errors import GeometryError, MemoryLimitError, RecordingError
from insonify.io.recordings.recording import Recording, RecordingWarning
from insonify.io.recordings.summary import describe_fan
from insonify.mapping.echoes import noise_threshold
from insonify.mapping.factory import bytes_per_voxel, make_mapper
from insonify.mapping.mapper import Mapper, MappingSettings, check_voxels
from insonify.mapping.voxels import (
    BLOCK,
    FARTHEST_BLOCK,
    VOXELS_PER_BLOCK,
    VoxelMap,
    probability_from_log_odds,
)
from insonify.mission.result import MapResult
from insonify.planning.entropy import binary_entropy
from insonify.types import Box, FanGeometry, Ping, Pose, PosedPing

KEPT_PINGS = 6
_ABOVE_WATER_M = 0.5
"""A vehicle that never comes lower is in doubt; at the surface it may well be less."""
_FAR_M, _ORIGIN_STEP_M = 10_000.0, 1000.0
"""Coordinates beyond are told from an origin of the map, rounded to so much."""
_NOISE_PINGS = 32


@dataclass(slots=True, eq=False)
class Remap:
    """A map made of recordings, and what went into it, in the map's own frame.

    Attributes:
        settings: How it was mapped.
        mapper: The mapper, with its map.
        sources: One entry a recording: file, format, pings, mapped and without a pose.
        poses: The vehicle's poses at the pings that were mapped.  Whoever maps for long may thin
            them, but for the last.
        pings: How many were mapped, and ``path_m`` how far the vehicle went from one to the next.
        fans: The fan geometries, in order of appearance.
        keyframes: Some pings, for pictures, with the name of their recording and their number.
        region: Where entropy is counted and shown.
        brightest: The largest pixel of those that were mapped.
        seconds: Wall time of reading and mapping.
    """

    settings: MappingSettings
    mapper: Mapper
    sources: list[dict[str, Any]] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    pings: int = 0
    path_m: float = 0.0
    fans: list[FanGeometry] = field(default_factory=list)
    keyframes: list[tuple[str, int, PosedPing]] = field(default_factory=list)
    region: Box = Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    brightest: float = 0.0
    seconds: dict[str, float] = field(default_factory=lambda: {"reading": 0.0, "mapping": 0.0})

    def result(self) -> MapResult:
        """Its figures."""
        voxels = self.mapper.voxels
        region = self.region.moved(voxels.origin_m)
        return MapResult(
            mapper=self.mapper.name,
            recordings=tuple(self.sources),
            pings=self.pings,
            path_m=round(self.path_m, 6),
            brightest_pixel=round(self.brightest, 6),
            fans=tuple(describe_fan(fan) for fan in self.fans),
            mapping=self.settings.model_dump(),
            occupied_voxels=voxels.count(lambda part: part.log_odds > 0.0),
            origin_m=voxels.origin_m,
            region_m=(region.low_m, region.high_m),
            region=_figures(voxels, self.region),
            seconds={name: round(value, 3) for name, value in self.seconds.items()},
        )


def _figures(voxels: VoxelMap, region: Box) -> dict[str, float]:
    """What is counted in a region; voxels that were never seen have an entropy of 1 bit."""
    total = math.prod(int(size) for size in np.subtract(*voxels.span(region)[::-1]))
    in_view = occupied = known = 0
    bits: list[float] = []
    for part in voxels.parts(region):
        inside = voxels.inside(part.coords, region)
        in_view += int(np.count_nonzero(inside & (part.seen > 0)))
        occupied += int(np.count_nonzero(inside & (part.log_odds > 0.0)))
        known += int(np.count_nonzero(inside))
        entropy = binary_entropy(probability_from_log_odds(part.log_odds))
        bits += np.where(inside, entropy, 0.0).sum(axis=1, dtype=np.float64).tolist()
    return {
        "voxels": total,
        "in_view": in_view,
        "occupied": occupied,
        "entropy_bits": round(math.fsum([total - known, *bits]), 3),
    }


Watch = Callable[[Remap, Recording, int, PosedPing], None]


def map_recordings(
    recordings: Sequence[Recording],
    settings: MappingSettings,
    region: Box | None = None,
    *,
    mapper: Mapper | None = None,
    watch: Watch = lambda remap, recording, number, posed: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Remap:
    """Map recordings into one map, in their order.

    Args:
        recordings: What was recorded; their poses share one world frame.
        settings: Voxel size and sensor model.
        region: Where entropy is counted; by default around the occupied voxels.
        mapper: Maps them; by default `bayes`.  Each recording is a scan of its.
        watch: Called after each ping with the map, its recording, its number from 1, and itself.
        should_stop: Asked after each ping; if true the map is what it is by then.

    Raises:
        RecordingError: A recording has no pose for any of its pings.
        MemoryLimitError: The map would not fit into the memory that is free.
    """
    if mapper is None:
        mapper = make_mapper("bayes", settings)
    check_voxels(mapper, settings)
    remap = Remap(settings, mapper)
    go_through(remap, recordings, watch, should_stop)
    settle_region(remap, region)
    return remap


def go_through(
    remap: Remap,
    recordings: Sequence[Recording],
    watch: Watch,
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Hand the pings of recordings to a map's mapper, and note what went into it.

    See `map_recordings`.
    """
    for recording in recordings:
        _map_one(remap, recording, watch, should_stop)
        remap.mapper.finish_scan()
        if should_stop():
            break


def settle_region(remap: Remap, region: Box | None) -> None:
    """Say where a map's entropy is counted, by default around what is occupied."""
    if not any((part.log_odds > 0.0).any() for part in remap.mapper.voxels.parts()):
        _warn_of_nothing(remap)
    voxels = remap.mapper.voxels
    remap.region = (
        voxels.around_occupied() if region is None else region.relative_to(voxels.origin_m)
    )


def echo_threshold(recordings: Sequence[Recording]) -> int:
    """The least pixel threshold, of 255, above the noise of all recordings (`noise_threshold`).

    Told from some pings of each, those with the number of bins that most have.

    Raises:
        RecordingError: There are no pings.
    """
    most = 0
    for recording in recordings:
        stride = max(1, recording.count // _NOISE_PINGS)
        images = [
            np.nan_to_num(one.ping.image) for one in itertools.islice(recording, 0, None, stride)
        ]
        if not images:
            raise RecordingError(f"{recording.path}: there are no pings in it")
        bins = Counter(len(image) for image in images).most_common(1)[0][0]
        alike = [image for image in images if len(image) == bins]
        most = max(most, math.ceil(255.0 * noise_threshold(alike)))
    return min(most, 254)


def brightest(ping: Ping) -> float:
    """The largest of a ping's pixels that are known; 0 if none is."""
    return float(np.fmax.reduce(ping.image, axis=None, initial=0.0))


def _origin(first: Pose, block_m: float) -> tuple[float, float, float]:
    """Where a map's frame lies: 0, or near its first pose where that is far away.

    A whole number of blocks from 0, so that voxels lie as they would without it.
    """
    step_m = block_m * math.ceil(_ORIGIN_STEP_M / block_m)
    x, y, z = (step_m * round(c / step_m) if abs(c) > _FAR_M else 0.0 for c in first.position_m)
    return x, y, z


def map_ping(remap: Remap, told: PosedPing, source: str) -> PosedPing:
    """Map a ping if it has a pose; it, in the map's own frame.

    Args:
        remap: The map.
        told: The ping, in the world.
        source: Where it is from, for messages.

    Raises:
        MemoryLimitError: The map would not fit into the memory that is free.
        GeometryError: The ping lies where no map reaches that holds what is mapped.
    """
    since = time.perf_counter()
    voxels = remap.mapper.voxels
    if told.pose is not None and not voxels.block_count and not remap.pings:
        voxels.origin_m = _origin(told.pose, voxels.block_m)
    posed = moved(told, voxels.origin_m)
    if posed.pose is not None:
        _check_reach(remap, source, posed.pose)
        _check_memory(remap, posed.ping.geometry)
        remap.mapper.integrate(posed.ping, posed.pose)
        if remap.poses:
            remap.path_m += math.dist(remap.poses[-1].position_m, posed.pose.position_m)
        remap.poses.append(posed.pose)
        remap.pings += 1
        remap.brightest = max(remap.brightest, brightest(posed.ping))
    remap.seconds["mapping"] += time.perf_counter() - since
    return posed


def _map_one(
    remap: Remap, recording: Recording, watch: Watch, should_stop: Callable[[], bool]
) -> None:
    kept = {(2 * k + 1) * recording.count // (2 * KEPT_PINGS) for k in range(KEPT_PINGS)}
    pings = mapped = 0
    for told in _timed(remap, recording):
        pings += 1
        posed = map_ping(remap, told, str(recording.path))
        if posed.pose is not None:
            mapped += 1
            if pings - 1 in kept:
                remap.keyframes.append((recording.path.name, pings, posed))
        watch(remap, recording, pings, posed)
        if should_stop():
            break
    if pings == 0:
        raise RecordingError(f"{recording.path}: there are no pings in it")
    if mapped == 0:
        raise RecordingError(_no_pose(recording, pings))
    doubts = [*recording.facts.get("doubts", ()), *_above_water(recording, remap, mapped)]
    for doubt in doubts:
        warnings.warn(f"{recording.path}: {doubt}", RecordingWarning, stacklevel=3)
    if mapped < pings:
        warnings.warn(
            f"{recording.path}: {pings - mapped} of {pings} pings have no pose at their time and "
            "are left out (--clock-offset moves the pings' clock, --max-gap bears longer gaps "
            "between poses)",
            RecordingWarning,
            stacklevel=3,
        )
    remap.sources.append(
        {
            "file": str(recording.path),
            "format": recording.format,
            "pings": pings,
            "mapped": mapped,
            "doubts": doubts,
        }
    )


def moved(posed: PosedPing, origin_m: tuple[float, float, float]) -> PosedPing:
    """A ping in the map's own frame."""
    if posed.pose is None or not any(origin_m):
        return posed
    true = posed.true_pose
    return replace(
        posed,
        pose=posed.pose.relative_to(origin_m),
        true_pose=None if true is None else true.relative_to(origin_m),
    )


def _above_water(recording: Recording, remap: Remap, mapped: int) -> list[str]:
    """A doubt of the last poses if they all lie above 0, unless they are known to be heights."""
    up_m = remap.mapper.voxels.origin_m[2]
    heights = [pose.z_m + up_m for pose in remap.poses[-mapped:]]
    lowest, highest = min(heights), max(heights)
    if recording.exact or lowest < _ABOVE_WATER_M:
        return []
    return [
        f"its poses lie {lowest:.3g} to {highest:.3g} m above 0, which is above the water where "
        "heights are told from its surface; if they are depths, say --convention ned"
    ]


def _warn_of_nothing(remap: Remap) -> None:
    threshold = remap.settings.pixel_threshold
    why = "silence outweighs every echo"
    if remap.brightest <= threshold / 255.0:
        why = (
            f"the brightest pixel is {255.0 * remap.brightest:.3g} of 255, and echoes are those "
            f"above {threshold}; lower it (--set mapping.pixel_threshold=...), or say which value "
            "of a pixel means the loudest (--scale)"
        )
    warnings.warn(f"nothing is occupied: {why}", RecordingWarning, stacklevel=3)


def _timed(remap: Remap, recording: Recording) -> Iterator[PosedPing]:
    """The pings of a recording; the time that each takes to come counts as reading."""
    since = time.perf_counter()
    for posed in recording:
        remap.seconds["reading"] += time.perf_counter() - since
        yield posed
        since = time.perf_counter()


def _no_pose(recording: Recording, pings: int) -> str:
    known = recording.facts.get("poses", "none")
    if known != "none":
        return (
            f"{recording.path}: none of its {pings} pings lies within the time of its poses "
            f"({known}); check that both are of one clock, or give --clock-offset"
        )
    each = "times in the recording's clock" if recording.timed else "one for each ping"
    return (
        f"{recording.path}: none of its {pings} pings has a pose, so there is no map to make; give "
        f"the vehicle's poses (--poses FILE, TUM format: time x y z qx qy qz qw a line, {each})"
    )


def _check_reach(remap: Remap, source: str, pose: Pose) -> None:
    """Refuse a pose so far from the map's origin that no map holds both.

    Raises:
        GeometryError: It is.
    """
    farthest_m = 0.9 * FARTHEST_BLOCK * remap.mapper.voxels.block_m
    away_m = max(map(abs, pose.position_m))
    if away_m > farthest_m:
        raise GeometryError(
            f"{source}: a ping lies {away_m / 1e3:.6g} km from where the map begins, and a "
            f"map of {remap.settings.voxel_m:g} m voxels reaches {farthest_m / 1e3:.4g} km; map "
            "places so far apart one by one, and check the poses"
        )


def _check_memory(remap: Remap, geometry: FanGeometry) -> None:
    """Refuse what would not fit, before the next ping is mapped."""
    voxels, voxel_m = remap.mapper.voxels, remap.settings.voxel_m
    per_voxel = bytes_per_voxel(remap.mapper.name, remap.settings)
    needed = float(voxels.block_count * VOXELS_PER_BLOCK * per_voxel) if voxels.in_memory else 0.0
    if all(replace(fan, mount=geometry.mount) != geometry for fan in remap.fans):
        remap.fans.append(geometry)
        far, half = geometry.range_max_m, geometry.elevation_fov_rad / 2
        volume = geometry.azimuth_fov_rad * 2 * math.sin(half) * far**3 / 3
        shell = geometry.azimuth_fov_rad * far**2 * 2 * BLOCK * voxel_m  # of blocks half inside
        needed += (volume + shell) / voxel_m**3 * per_voxel
        needed += (2 * far / (BLOCK * voxel_m)) ** 3 / 4 * 12  # the blocks that are looked at
    if not memory.fits(needed):
        raise MemoryLimitError(
            f"a map of {voxel_m:g} m voxels needs {memory.shortage(needed)}; keep it on disk "
            "(--memory), or take larger voxels (--voxel)"
        )
