"""The next scan for a map at hand, and how near it comes to what is mapped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from insonify.mapping.mapper import Belief
from insonify.mapping.voxels import VoxelMap
from insonify.planning.active import EntropyPlanner, EntropySettings
from insonify.planning.decision import Decision, SurveyArea
from insonify.types import Box, FanGeometry, Float64, Nav, Pose, ScanPath

_FIRST_REACH_M = 10.0


def plan_next(
    belief: Belief,
    geometry: FanGeometry,
    region: Box,
    pose: Pose,
    settings: EntropySettings,
    waypoints: int,
) -> Decision:
    """What the entropy planner would scan next, at the vehicle's height.

    Args:
        belief: What is known.
        geometry: The sonar that will scan.
        region: Where uncertainty counts.
        pose: Where the vehicle is.
        settings: The planner's.
        waypoints: Pings of the scan.
    """
    area = SurveyArea(region, pose.z_m, pose.yaw_rad, 0.0, 0.0, waypoints)
    nav = Nav(pose, (ScanPath((pose,)),))  # the map's own scans: the first has been flown
    return EntropyPlanner(area, geometry, settings).next_scan(belief, nav)


def clearance_m(voxels: VoxelMap, way: Sequence[Pose]) -> float:
    """Least distance of a way's straight legs to the surface of an occupied voxel."""
    corners = np.array([pose.position_m for pose in way])
    around, extent = Box.of(corners.min(axis=0), corners.max(axis=0)), voxels.extent()
    reach_m = _FIRST_REACH_M
    while True:  # farther and farther: most of a large map is far away
        box = around.grown(reach_m)
        occupied = voxels.occupied_m(box)
        nearest_m = min(_nearest_m(occupied, *leg) for leg in pairwise([*way, way[-1]]))
        whole = np.all(np.less(box.low_m, extent.low_m)) and np.all(
            np.greater(box.high_m, extent.high_m)
        )
        if nearest_m <= reach_m or whole:
            return max(0.0, nearest_m - half_diagonal_m(voxels))
        reach_m *= 4.0


def half_diagonal_m(voxels: VoxelMap) -> float:
    """How far a voxel's corners are from its centre."""
    return voxels.voxel_m * math.sqrt(3.0) / 2


def turns_of(way: Sequence[Pose]) -> tuple[Pose, ...]:
    """The poses of a way at which it or its heading turns, with both ends."""
    kept = [way[0]]
    for before, here, after in zip(way, way[1:], way[2:], strict=False):
        into = np.subtract(here.position_m, before.position_m)
        out = np.subtract(after.position_m, here.position_m)
        along = float(into @ out)
        straight = along >= 0.0 and np.linalg.norm(np.cross(into, out)) <= 1e-6 * along
        even = max(_turned(before, here), _turned(here, after)) < 1e-6
        if not (straight and even):
            kept.append(here)
    return (*kept, way[-1]) if len(way) > 1 else tuple(kept)


def _turned(before: Pose, after: Pose) -> float:
    """By how much the heading changes, rad."""
    return abs(math.remainder(after.yaw_rad - before.yaw_rad, math.tau))


def comes_near(voxels: VoxelMap, way: Sequence[Pose], clearance_m: float) -> bool:
    """Whether a way's straight legs come so near to the centre of an occupied voxel."""
    for start, end in pairwise(way if len(way) > 1 else [*way, *way]):
        corners = np.array([start.position_m, end.position_m])
        box = Box.of(corners.min(axis=0), corners.max(axis=0)).grown(clearance_m)
        if _nearest_m(voxels.occupied_m(box), start, end) < clearance_m:
            return True
    return False


def _nearest_m(points_m: Float64, start: Pose, end: Pose) -> float:
    """Least distance of points (N, 3) to a straight leg."""
    origin, along = np.array(start.position_m), np.subtract(end.position_m, start.position_m)
    share = np.clip((points_m - origin) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    away = np.linalg.norm(points_m - origin - share[:, None] * along, axis=1)
    return float(away.min(initial=math.inf))
