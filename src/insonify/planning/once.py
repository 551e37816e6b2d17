"""The next scan for a map at hand, and how near it comes to what is mapped."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from insonify.mapping.mapper import Belief
from insonify.mapping.voxels import VoxelMap
from insonify.planning.active import EntropyPlanner, EntropySettings
from insonify.planning.decision import Decision, SurveyArea
from insonify.types import Box, FanGeometry, Nav, Pose, ScanPath


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
