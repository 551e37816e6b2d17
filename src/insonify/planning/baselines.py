"""The scans the method is compared with (Park et al. 2025, section 4 and Fig. 7)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace

from insonify.mapping.mapper import Belief
from insonify.planning.candidates import straight_path
from insonify.planning.decision import Decision, SurveyArea
from insonify.planning.rosette import rosette_around
from insonify.types import FanGeometry, Nav, Pose, ScanPath, StopReason

_REACH = 0.95
"""Share of the sonar's range within which a near scan begins."""


def path_over_centre(area: SurveyArea, heading_rad: float) -> ScanPath:
    """A straight scan over the area's centre, from ``approach_m`` before the area to beyond it."""
    x, y, _ = area.region.centre_m
    ahead = (math.cos(heading_rad), math.sin(heading_rad))
    before = area.approach_m + area.extent_m(heading_rad) / 2
    start = Pose(
        x - before * ahead[0],
        y - before * ahead[1],
        area.z_m,
        yaw_rad=heading_rad,
    )
    end = (x + area.overrun_m * ahead[0], y + area.overrun_m * ahead[1])
    return straight_path(start, end, area.waypoints)


def near_area(area: SurveyArea, geometry: FanGeometry, least_altitude_m: float) -> SurveyArea:
    """The order as a careful pilot would have it: from the sonar's range, as high as a rosette.

    The paper's scans begin where the object is far out of range, at one height for all objects.

    Args:
        area: The paper's order.
        geometry: The sonar.
        least_altitude_m: See `rosette_around`.
    """
    z_m = area.z_m
    if geometry.tilt_rad > 0.0:
        z_m = rosette_around(area, geometry, least_altitude_m).top_m
    drop_m = max(0.0, z_m - area.region.low_m[2])
    reach_m = math.sqrt(max(0.0, (_REACH * geometry.range_max_m) ** 2 - drop_m**2))
    before_m = max(area.overrun_m, reach_m - area.extent_m(area.heading_rad) / 2)
    return replace(area, z_m=z_m, approach_m=before_m)


class FixedPlan(ABC):
    """A number of scans known beforehand; the map is not looked at."""

    name: str

    def __init__(self, area: SurveyArea, scans: int, name: str = "") -> None:
        """Plan ``scans`` scans of an area, under another name if one is given."""
        self.area = area
        self.scans = scans
        self.name = name or self.name

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        """The next scan of the plan."""
        done = len(nav.scans)
        if done == self.scans:
            return Decision(stop=StopReason.PLAN_FLOWN)
        return Decision(path=self._scan(done))

    @property
    def plan(self) -> tuple[ScanPath, ...]:
        """All scans, in order."""
        return tuple(self._scan(number) for number in range(self.scans))

    @abstractmethod
    def _scan(self, number: int) -> ScanPath:
        """Scan ``number``, counted from 0."""


class UniformPlanner(FixedPlan):
    """Uniform 360: straight scans over the centre, their headings dividing the circle equally."""

    name = "uniform"

    def _scan(self, number: int) -> ScanPath:
        heading = self.area.heading_rad + 2.0 * math.pi * number / self.scans
        return path_over_centre(self.area, heading)


class LawnmowerPlanner(FixedPlan):
    """Parallel tracks across the area, flown to and fro.

    Each track starts where the object is not yet in view and ends beyond the area's centre, as the
    first scan does; the tracks divide the area's width equally, from one side to the other.
    """

    name = "lawnmower"

    def _scan(self, number: int) -> ScanPath:
        along = self.area.heading_rad
        width_m = self.area.extent_m(along + math.pi / 2)
        aside_m = width_m * ((number + 0.5) / self.scans - 0.5)
        over = path_over_centre(self.area, along + (math.pi if number % 2 else 0.0))
        return ScanPath(
            tuple(
                Pose(
                    p.x_m - math.sin(along) * aside_m,
                    p.y_m + math.cos(along) * aside_m,
                    p.z_m,
                    yaw_rad=p.yaw_rad,
                )
                for p in over.waypoints
            )
        )
