"""Where to scan from: candidate poses on a circle, and the path from the chosen one.

Park et al. 2025, eq. 4, 5 and 8.
"""

from __future__ import annotations

import math

from insonify.planning.clusters import Cluster
from insonify.types import FanGeometry, Pose, ScanPath

_REACH = 0.9
"""Share of the range within which a scan keeps its target: what lies behind it shows too."""


def standoff_radius(cluster: Cluster, z_m: float, geometry: FanGeometry) -> float:
    """Radius of the candidate circle at which the sonar's axis meets the cluster's centre.

    A tilted sonar sees a point below it only from some way off.  At the cluster's own radius r,
    which eq. 4 takes, it may look over its target; so the radius is at least
    ``(z - z_c) / tan(tilt)``, or as near to it as keeps the centre in range.
    """
    drop_m = max(0.0, z_m - cluster.centre_m[2])
    farthest = math.sqrt(max(0.0, (_REACH * geometry.range_max_m) ** 2 - drop_m**2))
    on_axis = drop_m / math.tan(geometry.tilt_rad) if geometry.tilt_rad > 1e-3 else math.inf
    return max(cluster.radius_m, min(on_axis, farthest))


def candidate_poses(cluster: Cluster, radius_m: float, z_m: float, count: int) -> tuple[Pose, ...]:
    """P_sample: poses evenly on a circle around the cluster, facing its centre (eq. 4 and 5)."""
    x_c, y_c, _ = cluster.centre_m
    poses = []
    for i in range(count):
        angle = 2.0 * math.pi * i / count
        x, y = x_c + radius_m * math.cos(angle), y_c + radius_m * math.sin(angle)
        poses.append(Pose(x, y, z_m, yaw_rad=math.atan2(y_c - y, x_c - x)))
    return tuple(poses)


def straight_path(start: Pose, end_xy_m: tuple[float, float], waypoints: int) -> ScanPath:
    """``waypoints`` poses from a start to a point at the same height and heading (eq. 8).

    A path of one waypoint is its start alone.
    """
    steps = max(1, waypoints - 1)
    x_end, y_end = end_xy_m
    return ScanPath(
        tuple(
            Pose(
                (1.0 - j / steps) * start.x_m + j / steps * x_end,
                (1.0 - j / steps) * start.y_m + j / steps * y_end,
                start.z_m,
                start.roll_rad,
                start.pitch_rad,
                start.yaw_rad,
            )
            for j in range(waypoints)
        )
    )
