"""A map from recordings, and where to scan next: the method on pings that others recorded."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import psutil

from insonify.errors import GeometryError, MemoryLimitError, RecordingError
from insonify.io.recordings.recording import RecordedPing, Recording, RecordingWarning
from insonify.io.recordings.summary import describe_fan
from insonify.mapping.bayes import BayesMapper, MappingSettings
from insonify.mapping.voxels import BLOCK, BYTES_PER_VOXEL, VOXELS_PER_BLOCK, VoxelMap
from insonify.planning.active import EntropyPlanner, EntropySettings
from insonify.planning.decision import Decision, SurveyArea
from insonify.planning.entropy import entropy_map
from insonify.types import Box, FanGeometry, Nav, Pose, ScanPath

KEPT_PINGS = 6
MOST_REGION_VOXELS = 150_000_000
BYTES_PER_BLOCK = VOXELS_PER_BLOCK * BYTES_PER_VOXEL
_GROWTH = 3
"""Memory at a moment when the map's arrays double: the old ones and the new."""


@dataclass(slots=True, eq=False)
class Replay:
    """A map made of recordings, and what went into it.

    Attributes:
        settings: How it was mapped.
        mapper: The mapper, with its map.
        sources: One entry a recording: file, format, pings, mapped and without a pose.
        poses: The vehicle's poses at the pings that were mapped.
        fans: The fan geometries, in order of appearance.
        keyframes: Some pings, for pictures, with the name of their recording and their number.
        region: Where entropy is counted and shown.
        seconds: Wall time of reading and mapping.
    """

    settings: MappingSettings
    mapper: BayesMapper
    sources: list[dict[str, Any]] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    fans: list[FanGeometry] = field(default_factory=list)
    keyframes: list[tuple[str, int, RecordedPing]] = field(default_factory=list)
    region: Box = Box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    seconds: dict[str, float] = field(default_factory=lambda: {"reading": 0.0, "mapping": 0.0})

    def result(self) -> dict[str, Any]:
        """The map as one JSON-ready row."""
        window = self.mapper.voxels.window(self.region)
        legs = pairwise(self.poses)
        return {
            "recordings": self.sources,
            "pings": len(self.poses),
            "path_m": round(sum(math.dist(a.position_m, b.position_m) for a, b in legs), 6),
            "fans": [describe_fan(fan) for fan in self.fans],
            "mapping": self.settings.model_dump(),
            "occupied_voxels": int((self.mapper.voxels.log_odds > 0.0).sum()),
            "region_m": [list(self.region.low_m), list(self.region.high_m)],
            "region": {
                "voxels": window.seen.size,
                "in_view": int((window.seen > 0).sum()),
                "occupied": int(window.occupied.sum()),
                "entropy_bits": round(float(entropy_map(window).sum(dtype=np.float64)), 3),
            },
            "seconds": {name: round(value, 3) for name, value in self.seconds.items()},
        }


Watch = Callable[[Replay, Recording, int, RecordedPing], None]


def map_recordings(
    recordings: Sequence[Recording],
    settings: MappingSettings,
    region: Box | None = None,
    *,
    watch: Watch = lambda replay, recording, number, recorded: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Replay:
    """Map recordings into one map, in their order.

    Args:
        recordings: What was recorded; their poses share one world frame.
        settings: Voxel size and sensor model.
        region: Where entropy is counted; by default around the occupied voxels.
        watch: Called after each ping with the replay, its recording, its number from 1, and itself.
        should_stop: Asked after each ping; if true the map is what it is by then.

    Raises:
        RecordingError: A recording has no pose for any of its pings.
        MemoryLimitError: The map would not fit into the memory that is free.
        GeometryError: The region is too large to show.
    """
    replay = Replay(settings, BayesMapper(settings))
    for recording in recordings:
        _map_one(replay, recording, watch, should_stop)
        if should_stop():
            break
    replay.region = region or around_occupied(replay.mapper.voxels)
    voxels = math.prod(size / settings.voxel_m for size in replay.region.size_m)
    if voxels > MOST_REGION_VOXELS:
        size = " x ".join(f"{edge:.3g}" for edge in replay.region.size_m)
        raise GeometryError(
            f"the region of {size} m has {voxels:.3g} voxels of {settings.voxel_m:g} m, too many "
            "to count its entropy; give a smaller one (--region) or larger voxels (--voxel)"
        )
    return replay


def _map_one(
    replay: Replay,
    recording: Recording,
    watch: Watch,
    should_stop: Callable[[], bool],
) -> None:
    kept = {(2 * k + 1) * recording.count // (2 * KEPT_PINGS) for k in range(KEPT_PINGS)}
    pings = mapped = 0
    since = time.perf_counter()
    for recorded in recording:
        pings += 1
        now = time.perf_counter()
        replay.seconds["reading"] += now - since
        if recorded.pose is not None:
            _check_memory(replay, recorded.ping.geometry)
            replay.mapper.integrate(recorded.ping, recorded.pose)
            replay.poses.append(recorded.pose)
            mapped += 1
            if pings - 1 in kept:
                replay.keyframes.append((recording.path.name, pings, recorded))
        since = time.perf_counter()
        replay.seconds["mapping"] += since - now
        watch(replay, recording, pings, recorded)
        if should_stop():
            break
    if pings == 0:
        raise RecordingError(f"{recording.path}: there are no pings in it")
    if mapped == 0:
        raise RecordingError(_no_pose(recording, pings))
    if mapped < pings:
        warnings.warn(
            f"{recording.path}: {pings - mapped} of {pings} pings have no pose at their time and "
            "are left out (--clock-offset moves the pings' clock)",
            RecordingWarning,
            stacklevel=3,
        )
    replay.sources.append(
        {
            "file": str(recording.path),
            "format": recording.format,
            "pings": pings,
            "mapped": mapped,
        }
    )


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


def _check_memory(replay: Replay, geometry: FanGeometry) -> None:
    """Refuse what would not fit, before the next ping is mapped."""
    voxels, voxel_m = replay.mapper.voxels, replay.settings.voxel_m
    needed = float(voxels.block_count * BYTES_PER_BLOCK * _GROWTH)
    if geometry not in replay.fans:
        replay.fans.append(geometry)
        far, half = geometry.range_max_m, geometry.elevation_fov_rad / 2
        volume = geometry.azimuth_fov_rad * 2 * math.sin(half) * far**3 / 3
        shell = geometry.azimuth_fov_rad * far**2 * 2 * BLOCK * voxel_m  # of blocks half inside
        needed += (volume + shell) / voxel_m**3 * BYTES_PER_VOXEL * _GROWTH
        needed += (2 * far / (BLOCK * voxel_m)) ** 3 / 4 * 12  # the blocks that are looked at
    free = psutil.virtual_memory().available
    if needed > 0.9 * free:
        raise MemoryLimitError(
            f"a map of {voxel_m:g} m voxels needs about {needed / 1e9:.3g} GB and "
            f"{free / 1e9:.3g} GB are free; take larger voxels (--voxel)"
        )


def around_occupied(voxels: VoxelMap) -> Box:
    """The occupied voxels and a block around them; all of the map if none is occupied."""
    occupied = voxels.occupied_m()
    if len(occupied):
        return Box.of(occupied.min(axis=0), occupied.max(axis=0)).grown(voxels.block_m)
    low, high = voxels.coords.min(axis=0), voxels.coords.max(axis=0) + 1
    return Box.of(low * voxels.block_m, high * voxels.block_m)


def plan_next(
    voxels: VoxelMap,
    geometry: FanGeometry,
    region: Box,
    pose: Pose,
    settings: EntropySettings,
    waypoints: int,
) -> Decision:
    """What the entropy planner would scan next, at the vehicle's height.

    Args:
        voxels: What is known.
        geometry: The sonar that will scan.
        region: Where uncertainty counts.
        pose: Where the vehicle is.
        settings: The planner's.
        waypoints: Pings of the scan.
    """
    area = SurveyArea(region, pose.z_m, pose.yaw_rad, 0.0, 0.0, waypoints)
    nav = Nav(pose, (ScanPath((pose,)),))  # the map's own scans: the first has been flown
    return EntropyPlanner(area, geometry, settings).next_scan(voxels, nav)


def clearance_m(voxels: VoxelMap, pose: Pose, path: ScanPath) -> float:
    """Least distance of the way to a path, and of the path, to the surface of an occupied voxel."""
    occupied = voxels.occupied_m()
    nearest = math.inf
    corners = [pose.position_m, path.waypoints[0].position_m, path.waypoints[-1].position_m]
    for start, end in pairwise(np.array(corners)):
        along = end - start
        square = max(float(along @ along), 1e-12)
        share = np.clip((occupied - start) @ along / square, 0.0, 1.0)
        away = np.linalg.norm(occupied - start - share[:, None] * along, axis=1)
        nearest = min(nearest, float(away.min(initial=math.inf)))
    return max(0.0, nearest - voxels.voxel_m * math.sqrt(3.0) / 2)
