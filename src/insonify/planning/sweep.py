"""The search of a large area: parallel tracks on which the vehicle turns its sonar to and fro.

A forward-looking sonar's fan is narrow: flown straight ahead it sees a strip a few metres wide.
Turned to and fro it sees as far to either side as ahead, and each place from several sides.
"""

from __future__ import annotations

import math
from itertools import pairwise

from insonify.planning.decision import SurveyArea
from insonify.types import FanGeometry, Pose, ScanPath

_SIDE_RAD = math.radians(75.0)
"""How far aside the edge of the fan is turned."""
_STEP = 0.8
"""Of the fan's width, by which it is turned from ping to ping."""
_PASSES = 1.5
"""Turns to and fro while the vehicle goes as far as the seabed is seen ahead."""
_EDGE = 0.3
"""Of the tracks' distance, by which the outer ones are nearer to the edges: from there no
neighbour sees them too."""
_REACH = 0.92
"""Of the range, in which seabed is seen."""


def seabed_in_view_m(geometry: FanGeometry, height_m: float) -> tuple[float, float]:
    """From how far ahead to how far a sonar at a height sees the seabed, horizontally.

    A sonar that looks over it sees what stands on it; then it is all the range.
    """
    half = geometry.elevation_fov_rad / 2
    far_m = math.sqrt(max((_REACH * geometry.range_max_m) ** 2 - height_m**2, 0.01))
    lower, upper = geometry.tilt_rad + half, geometry.tilt_rad - half
    if upper > 0.0:
        far_m = min(far_m, height_m / math.tan(min(upper, 1.5)))
    near_m = height_m / math.tan(min(lower, 1.5)) if lower > 0.01 else 0.0
    return min(near_m, 0.8 * far_m), far_m


def sweep(
    area: SurveyArea, geometry: FanGeometry, z_m: float, ping_m: float
) -> tuple[ScanPath, ...]:
    """Tracks along an area's long side and what joins them, one after another.

    Args:
        area: What is searched.
        geometry: The sonar.
        z_m: Height of all of them, world frame.
        ping_m: Largest distance between pings.
    """
    near_m, far_m = seabed_in_view_m(geometry, max(z_m - area.region.low_m[2], 0.1))
    swing_rad = max(0.0, _SIDE_RAD - geometry.azimuth_fov_rad / 2)
    middle_m = (near_m + far_m) / 2
    aside_m = middle_m * math.sin(min(swing_rad + geometry.azimuth_fov_rad / 4, math.pi / 2))
    turn_rad = _STEP * geometry.azimuth_fov_rad
    turns = max(1.0, 4.0 * swing_rad / turn_rad)
    ping_m = min(ping_m, (far_m - near_m) / (_PASSES * turns))
    paths, pings = [], 0
    for start, end in pairwise(_corners(area, aside_m, near_m, middle_m * math.cos(swing_rad))):
        ahead = math.atan2(end[1] - start[1], end[0] - start[0])
        count = max(1, round(math.dist(start, end) / ping_m))
        poses = []
        for t in ((k + 0.5) / count for k in range(count)):
            off = (pings * turn_rad + swing_rad) % (4.0 * swing_rad) if swing_rad else 0.0
            off = min(off, 4.0 * swing_rad - off) - swing_rad
            x, y = (a + t * (b - a) for a, b in zip(start, end, strict=True))
            poses.append(Pose(x, y, z_m, yaw_rad=math.remainder(ahead + off, math.tau)))
            pings += 1
        paths.append(ScanPath(tuple(poses)))
    return tuple(paths)


def _corners(
    area: SurveyArea, aside_m: float, before_m: float, short_m: float
) -> list[tuple[float, float]]:
    """Ends of the tracks, in order.

    Args:
        area: What is searched.
        aside_m: How far to either side of a track is seen.
        before_m: How far before the area they begin.
        short_m: How far before its other end they end.
    """
    along = area.region.size_m[0] >= area.region.size_m[1]
    low, high = area.region.low_m, area.region.high_m
    (a, b), (c, d) = ((low[k], high[k]) for k in ((0, 1) if along else (1, 0)))
    tracks = max(1, math.ceil((d - c) / (2.0 * aside_m) + _EDGE))
    apart_m = (d - c) / (tracks - _EDGE)
    corners = []
    for number in range(tracks):
        across = (c + d) / 2 + apart_m * (number - (tracks - 1) / 2)
        ends = [(a - before_m, across), (b - short_m, across)]
        if number % 2:
            ends = [(b + before_m, across), (a + short_m, across)]
        corners += ends if along else [(y, x) for x, y in ends]
    return corners
