"""Paths that map one object well: the vehicle faces it while it sweeps in and out around it.

Nothing of it is from Park et al.: their straight scans have the object in view in half of their
pings, a rosette in most.  All follows from the region and the sonar, before the first ping.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.mapping.mapper import Belief
from insonify.planning.decision import Decision, SurveyArea
from insonify.types import FanGeometry, Nav, Pose, ScanPath, StopReason

_LOBES = 6
"""Of a turn."""
DISTINCT_LOBES = 2 * _LOBES
"""Those of a later turn are where these are."""
_FLOOR_M, _HEADROOM_M = 0.2, 0.5
"""How far a region's floor is above the seabed, and its top above the object."""
_REACH, _HIGHEST, _LOW = 0.88, 0.405, 0.33
"""Of the sonar's range: the farthest that an object is looked at, and heights flown at."""
_TALL = 0.4
"""Of the sonar's range: from the top of so tall an object it does not hear the seabed."""
_FINE = 400
"""Points of a lobe from which pings are chosen by distance."""


class RosetteSettings(Settings):
    """Parameters of the rosette."""

    pings: int = Field(160, ge=1, le=100000, description="how many pings at most")
    ping_m: float = Field(0.7, gt=0, le=100, description="a ping every so many metres")
    altitude_m: float = Field(
        0.0, ge=0, le=1000, description="least height above the floor; 0: what suits the mapper"
    )


@dataclass(frozen=True, slots=True)
class Rosette:
    """The shape of a rosette around a region.

    The vehicle goes round a stadium whose axis is the region's long side, always facing the axis.

    Attributes:
        centre_m: Its middle, horizontally.
        axis_rad: Direction of the stadium's axis.
        half_m: Half the length of its axis.
        near_m: Least distance from the axis.
        far_m: Largest, by turns of the lobes (even, odd).
        top_m: Height near the object, world frame.
        low_m: Height far from it, by turns of the lobes.
        region_m: Half sizes of the region, grown by what keeps the vehicle off it.
        over_m: Least height over the region, world frame.
        storeys_m: Heights of the lobes between those over the top, of a region too tall for the
            sonar to hear the seabed from there.
    """

    centre_m: tuple[float, float]
    axis_rad: float
    half_m: float
    near_m: float
    far_m: tuple[float, float]
    top_m: float
    low_m: tuple[float, float]
    region_m: tuple[float, float]
    over_m: float
    storeys_m: tuple[float, ...] = ()

    def beyond_m(self, x_m: float, y_m: float) -> float:
        """How far a place is outside the region, grown as `region_m` is."""
        x, y = x_m - self.centre_m[0], y_m - self.centre_m[1]
        return math.hypot(max(0.0, abs(x) - self.region_m[0]), max(0.0, abs(y) - self.region_m[1]))

    def pose(self, angle_rad: float, radius_m: float, low_m: float) -> Pose:
        """The pose at an angle of the stadium and a distance from its axis, facing the axis.

        ``low_m`` is the height to sink to outside the region.
        """
        along = self.half_m * math.cos(angle_rad - self.axis_rad)
        x = along * math.cos(self.axis_rad) + radius_m * math.cos(angle_rad)
        y = along * math.sin(self.axis_rad) + radius_m * math.sin(angle_rad)
        outside_m = self.beyond_m(self.centre_m[0] + x, self.centre_m[1] + y)
        z = self.top_m - (self.top_m - low_m) * min(1.0, outside_m / 2.0)
        if outside_m == 0.0:
            z = max(z, self.over_m)
        return Pose(
            self.centre_m[0] + x,
            self.centre_m[1] + y,
            z,
            yaw_rad=math.remainder(angle_rad + math.pi, math.tau),
        )


def rosette_around(area: SurveyArea, geometry: FanGeometry, least_altitude_m: float) -> Rosette:
    """A rosette around an area's region for a sonar.

    A sonar that looks down flies over the region and away from it.  One that does not reach the
    object from above goes round it at half its height.

    Args:
        area: The order; its region's floor is a little above the seabed.
        geometry: The sonar.
        least_altitude_m: Height above the seabed to keep at least, where the sonar reaches down.
    """
    region = area.region
    floor, top = region.low_m[2] - _FLOOR_M, region.high_m[2]
    size_x, size_y, _ = region.size_m
    over_m = top + 0.1
    breadth_m = max(1.0, min(size_x, size_y) / 4)
    reach_m = _REACH * geometry.range_max_m
    least_m = min(least_altitude_m, _HIGHEST * geometry.range_max_m)
    high_m = min(max(over_m - floor + 0.2, least_m), max(0.5, -0.5 - floor))  # in the water
    low_m = min(high_m, max(_LOW * geometry.range_max_m, least_m) - 0.8)
    height_m = max(top - _HEADROOM_M - floor, 0.1)
    tall = False
    if geometry.tilt_rad > math.atan((high_m - height_m / 2) / reach_m):
        steepest_rad = min(geometry.tilt_rad + geometry.elevation_fov_rad / 2, 1.5)
        flat = math.tan(min(geometry.tilt_rad, 1.5))
        far_m = [min(breadth_m / 2 + h / flat, reach_m) for h in (high_m, low_m)]
        near_m = max(1.0, (high_m - height_m) / math.tan(steepest_rad) - breadth_m / 2)
        near_m = max(0.5, min(near_m, min(far_m) - 2.0))
        tall = height_m > _TALL * geometry.range_max_m
    else:
        near_m = min(math.hypot(size_x, size_y) / 2 + 1.0, reach_m)
        far_m = [min(near_m + 3.0, reach_m)] * 2
        rise_m = (near_m + far_m[0]) / 2 * math.tan(geometry.tilt_rad)
        high_m = low_m = min(max(height_m / 2 + rise_m, 0.5), -0.5 - floor)
    return Rosette(
        centre_m=region.centre_m[:2],
        axis_rad=0.0 if size_x >= size_y else math.pi / 2,
        half_m=0.7 * abs(size_x - size_y) / 2,
        near_m=near_m,
        far_m=(far_m[0], far_m[1]),
        top_m=floor + high_m,
        low_m=(floor + high_m, floor + low_m),
        region_m=(size_x / 2 + 0.6, size_y / 2 + 0.6),
        over_m=over_m,
        storeys_m=_storeys(height_m, floor, high_m) if tall else (),
    )


def _storeys(height_m: float, floor_m: float, high_m: float) -> tuple[float, ...]:
    """Beside the object at half its height, over it by more than needs be, and beside it lower."""
    most_m = max(floor_m + high_m, -0.5)
    shares = (0.58 * height_m, high_m + 1.5, 0.43 * height_m)
    return tuple(min(floor_m + max(share, 1.0), most_m) for share in shares)


def lobe(rosette: Rosette, number: int, heading_rad: float, lobes: int = _LOBES) -> list[Pose]:
    """Closely spaced poses of a lobe: out, in, out again while it turns by its part of a circle.

    Args:
        rosette: The shape.
        number: Which lobe, from 0; after each turn all are moved by half a lobe.
        heading_rad: The first begins where a vehicle that comes at this heading is.
        lobes: Of a turn.
    """
    turn, wide_rad = number // lobes, math.tau / lobes
    start = heading_rad + math.pi + number * wide_rad + turn * wide_rad / 2
    far, low = rosette.far_m[turn % 2], rosette.low_m[turn % 2]
    if rosette.storeys_m and number % (len(rosette.storeys_m) + 1):
        storey_m = rosette.storeys_m[number % (len(rosette.storeys_m) + 1) - 1]
        return _at_height(rosette, _out_and_in(start, wide_rad, rosette.near_m, far), storey_m)
    poses = []
    if turn and number % lobes == 0:  # on from where the last turn ended
        before, lower = rosette.far_m[1 - turn % 2], rosette.low_m[1 - turn % 2]
        for t in np.linspace(0.0, 1.0, _FINE).tolist():
            angle = start - (1.0 - t) * wide_rad / 2
            poses.append(
                rosette.pose(angle, before + t * (far - before), lower + t * (low - lower))
            )
    for angle, radius in _out_and_in(start, wide_rad, rosette.near_m, far):
        poses.append(rosette.pose(angle, radius, low))
    return poses


def _out_and_in(
    start_rad: float, wide_rad: float, near_m: float, far_m: float
) -> Iterator[tuple[float, float]]:
    """Angles and distances of a lobe."""
    for t in np.linspace(0.0, 1.0, _FINE).tolist():
        yield (
            start_rad + wide_rad * t,
            near_m + (far_m - near_m) * (1.0 + math.cos(math.tau * t)) / 2,
        )


def _at_height(rosette: Rosette, places: Iterable[tuple[float, float]], z_m: float) -> list[Pose]:
    """Places of a lobe at one height: over the region, or if that is too low for it, beside it."""
    poses = []
    for angle, radius in places:
        pose = replace(rosette.pose(angle, radius, z_m), z_m=z_m)
        while z_m < rosette.over_m and rosette.beyond_m(pose.x_m, pose.y_m) < 0.05:
            radius += 0.05
            pose = replace(rosette.pose(angle, radius, z_m), z_m=z_m)
        poses.append(pose)
    return poses


class RosettePlanner:
    """Lobes around the region until the pings are used up."""

    name = "rosette"

    def __init__(
        self,
        area: SurveyArea,
        geometry: FanGeometry,
        settings: RosetteSettings,
        least_altitude_m: float = 0.0,
    ) -> None:
        """Plan lobes around an area with a sonar."""
        self.settings = settings
        altitude_m = settings.altitude_m or least_altitude_m
        self.shape = rosette_around(area, geometry, altitude_m)
        self._heading_rad = area.heading_rad

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        """The next lobe, or the end of the pings."""
        left = self.settings.pings - sum(len(scan.waypoints) for scan in nav.scans)
        if left <= 0:
            return Decision(stop=StopReason.PLAN_FLOWN)
        last = nav.scans[-1].waypoints[-1] if nav.scans else None
        return Decision(path=self.lobe_path(len(nav.scans), last, left))

    def lobe_path(self, number: int, last: Pose | None, most: int) -> ScanPath:
        """A lobe by its number from 0, on from the last ping, of so many pings at most."""
        poses = lobe(self.shape, number, self._heading_rad)
        return ScanPath(pings_along(poses, self.settings.ping_m, last)[:most])


def pings_along(poses: list[Pose], ping_m: float, last: Pose | None) -> tuple[Pose, ...]:
    """Those of closely spaced poses that lie ``ping_m`` apart, counted from the last one."""
    chosen: list[Pose] = [] if last is not None else [poses[0]]
    since = 0.0
    before = last if last is not None else poses[0]
    for pose in poses:
        since += math.dist(before.position_m, pose.position_m)
        before = pose
        if since >= ping_m:
            chosen.append(pose)
            since = 0.0
    return tuple(chosen) or (poses[-1],)
