"""Search a large area, then look at what stands out, as long as that tells enough a metre.

For several objects at unknown places, and for objects of which the area holds a part.  Nothing of
it is from Park et al., whose straight scans it weighs beside its own paths.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.mapping.mapper import Belief
from insonify.planning.baselines import LawnmowerPlanner, UniformPlanner, near_area
from insonify.planning.candidates import candidate_poses, standoff_radius, straight_path
from insonify.planning.clusters import Cluster
from insonify.planning.decision import Decision, SurveyArea
from insonify.planning.finds import Find, Obstacles, find_in, find_of, outstanding
from insonify.planning.rosette import lobe, pings_along, rosette_around
from insonify.planning.sweep import seabed_in_view_m, sweep
from insonify.types import Box, FanGeometry, Nav, Pose, ScanPath, StopReason

_GROWN = 1.25
"""So many times as much as when it was left makes a find worth a look again."""
_LOBES = 4
"""Of a turn round a find."""
_SETTLES = 0.1
"""Share of a doubt that a ping is expected to settle, of those that looks from a side can."""
_A_SIDE, _SIDE_RAD = 0.35, math.tau / 8
"""Share of a doubt that looks from one side settle at most, and how wide a side is."""
_ASKED = 10
"""Poses of a path for which the mapper is asked what they would tell."""
_NEAREST = 3
"""Finds that are weighed at a time: those with the most doubt for the way there."""
_STRAIGHT = 4
"""Straight scans that are weighed: headings over a find, and over the area."""
_BEYOND_M = 2.0
"""How far beyond what is known so far, horizontally, something may go on."""


class InformationSettings(Settings):
    """Parameters of the information planner."""

    pings: int = Field(3000, ge=1, le=100000, description="how many pings at most")
    path_m: float = Field(0.0, ge=0, le=1e6, description="how far at most; 0: as pings allow")
    ping_m: float = Field(0.45, gt=0, le=100, description="a ping every so many metres")
    altitude_m: float = Field(
        0.0, ge=0, le=1000, description="least height above the floor; 0: what suits the mapper"
    )
    termination: float = Field(
        0.04,
        ge=0,
        le=1,
        description="a find is left when a look changes less than this share of its voxels",
    )


@dataclass(slots=True)
class Visit:
    """What has come of the looks at a find.

    Attributes:
        box: Where it was.
        heading_rad: From where the first lobe began.
        lobes: How many were flown.
        left_with: How many voxels it held for occupied when it was left; None while it is not.
    """

    box: Box
    heading_rad: float
    lobes: int = 0
    left_with: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """A path that could be flown next: to see which find, and whether it is a lobe."""

    path: list[Pose]
    find: Find
    visit: Visit
    is_lobe: bool


class InformationPlanner:
    """A search, then lobes or straight scans, each the one that tells most a metre."""

    name = "information"

    def __init__(
        self,
        area: SurveyArea,
        geometry: FanGeometry,
        settings: InformationSettings,
        least_altitude_m: float = 0.0,
        clearance_m: float = 0.4,
    ) -> None:
        """Plan for an area with a sonar."""
        self.area, self.geometry, self.settings = area, geometry, settings
        self._altitude_m = settings.altitude_m or least_altitude_m
        self._clearance_m = clearance_m
        shape = rosette_around(area, geometry, self._altitude_m)
        z_m = min(max(shape.top_m, shape.over_m), -0.5)
        _, self._sees_m = seabed_in_view_m(geometry, max(z_m - area.region.low_m[2], 0.1))
        self._small = max(area.region.size_m[:2]) / 2 <= self._sees_m
        self.search = () if self._small else sweep(area, geometry, z_m, settings.ping_m)
        self._visits: list[Visit] = []
        self._flown: Choice | None = None

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        """The next track of the search, or what then tells most a metre."""
        if len(nav.scans) < len(self.search):
            return self._within_budget(list(self.search[len(nav.scans)].waypoints), nav)
        self._learn(belief)
        best, most = None, 0.0
        choices = list(self._choices(self.open_finds(belief), belief, nav.pose))
        for choice, settled in zip(choices, self._expected(choices, belief), strict=True):
            a_metre = settled / max(_length_m(choice.path), 1.0)
            if a_metre > most:
                best, most = choice, a_metre
        if best is None:
            return Decision(stop=StopReason.LITTLE_LEFT)
        self._flown = best
        last = nav.scans[-1].waypoints[-1] if nav.scans else None
        pings = pings_along(best.path, self.settings.ping_m, last)
        return self._within_budget(list(pings), nav)

    def _within_budget(self, pings: list[Pose], nav: Nav) -> Decision:
        """A scan, as far as pings and metres last."""
        flown = [pose for scan in nav.scans for pose in scan.waypoints]
        left, left_m = self.settings.pings - len(flown), self.settings.path_m - _length_m(flown)
        pings = pings[: max(left, 0)]
        if self.settings.path_m > 0.0:
            while pings and _length_m([*flown[-1:], *pings]) > left_m:
                pings.pop()
        if not pings:
            return Decision(stop=StopReason.PLAN_FLOWN)
        return Decision(path=ScanPath(tuple(pings)))

    def open_finds(self, belief: Belief) -> list[tuple[Find, Visit]]:
        """What stands out and was not left, or the area if that is small; with its visits."""
        region, voxels = self.area.region, belief.voxels
        looked_at = [visit.box.grown(_BEYOND_M) for visit in self._visits]
        finds = [find_in(voxels, box) for box in outstanding(voxels, region, looked_at)]
        if self._small:
            box = _around([region, *(find.box for find in finds)])
            finds = [find_of(box, finds or [find_in(voxels, region)])]
        found = []
        for find in finds:
            box = find.box
            visit = next((v for v in self._visits if _holds(box, v.box.centre_m)), None)
            visit = visit or Visit(box, self.area.heading_rad)
            grown = np.count_nonzero(find.held) > _GROWN * (visit.left_with or 0)
            if visit.left_with is None or grown:
                found.append((find, visit))
        return found

    def _choices(
        self, finds: Sequence[tuple[Find, Visit]], belief: Belief, here: Pose | None
    ) -> Iterator[Choice]:
        """A lobe and straight scans for the finds that promise most, and the area's own."""
        if not finds:
            return
        beyond_m = self._sees_m + 2.0
        obstacles = Obstacles(belief.voxels, self.area.region, self._clearance_m, beyond_m)

        def promise(one: tuple[Find, Visit]) -> float:
            find, _ = one
            away_m = math.dist(here.position_m, find.box.centre_m) if here else 0.0
            return find.doubt / (away_m + self._sees_m)

        for find, visit in sorted(finds, key=promise, reverse=True)[:_NEAREST]:
            if not visit.lobes and here is not None:
                x, y, _ = find.box.centre_m
                heading = math.atan2(y - here.y_m, x - here.x_m)
                visit = replace(visit, heading_rad=heading)
            area = replace(self.area, region=find.box)
            shape = rosette_around(area, self.geometry, self._altitude_m)
            poses = lobe(shape, visit.lobes, visit.heading_rad, _LOBES)
            yield Choice(obstacles.over(_joined(here, poses)), find, visit, is_lobe=True)
        find, visit = max(finds, key=promise)
        for poses in self._straight(find):
            yield Choice(obstacles.over(_joined(here, poses)), find, visit, is_lobe=False)
        area = near_area(self.area, self.geometry, self._altitude_m)
        for plan in (UniformPlanner(area, _STRAIGHT), LawnmowerPlanner(area, _STRAIGHT)):
            for scan in plan.plan:
                poses = list(scan.waypoints)
                yield Choice(obstacles.over(_joined(here, poses)), find, visit, is_lobe=False)

    def _straight(self, find: Find) -> Iterator[list[Pose]]:
        """Park et al.'s scans of a find (eq. 4, 5 and 8): from a circle around it to its centre."""
        around = Cluster.of(find.voxels_m, find.doubts.astype(np.float32))
        z_m = self.area.z_m
        radius_m = standoff_radius(around, z_m, self.geometry)
        x, y, _ = find.box.centre_m
        for pose in candidate_poses(around, radius_m, z_m, _STRAIGHT):
            yield list(straight_path(pose, (x, y), self.area.waypoints).waypoints)

    def _expected(self, choices: Sequence[Choice], belief: Belief) -> list[float]:
        """How much doubt about the finds each path should settle, by the mapper's own model."""
        if not choices:
            return []
        finds = {id(choice.find): choice.find for choice in choices}.values()
        voxels_m = np.concatenate([find.voxels_m for find in finds])
        doubts = np.concatenate([find.doubts for find in finds])
        gains = []
        for choice in choices:
            each = _length_m(choice.path) / self.settings.ping_m / _ASKED
            asked = _evenly(choice.path, _ASKED)
            looks = belief.tells(asked, self.geometry, voxels_m).astype(np.float64) * each
            sides = np.array([math.floor(pose.yaw_rad / _SIDE_RAD) for pose in asked])
            left = np.ones(len(voxels_m))
            for side in np.unique(sides):
                seen = looks[sides == side].sum(axis=0)
                left *= 1.0 - _A_SIDE * (1.0 - (1.0 - _SETTLES) ** seen)
            gains.append(float(doubts @ (1.0 - left)))
        return gains

    def _learn(self, belief: Belief) -> None:
        """Leave what was looked at last, if that changed little of it."""
        if self._flown is None:
            return
        choice, self._flown = self._flown, None
        before, visit = choice.find, choice.visit
        now = np.concatenate([find_in(belief.voxels, box).held for box in before.boxes])
        changed = int(np.count_nonzero(now != before.held))
        if not any(visit is known for known in self._visits):
            self._visits = [v for v in self._visits if not _holds(before.box, v.box.centre_m)]
            self._visits.append(visit)
        visit.lobes += choice.is_lobe
        visit.box = before.box
        if changed < self.settings.termination * np.count_nonzero(before.held):
            visit.left_with = int(np.count_nonzero(now))


def _joined(here: Pose | None, poses: list[Pose]) -> list[Pose]:
    """A path with the straight way there, on which the vehicle looks as it will at its end."""
    if here is None:
        return poses
    first = poses[0]
    steps = max(1, math.ceil(math.dist(here.position_m, first.position_m) / 0.1))
    way = []
    for k in range(1, steps):
        x, y, z = (
            a + (b - a) * k / steps for a, b in zip(here.position_m, first.position_m, strict=True)
        )
        way.append(replace(first, x_m=x, y_m=y, z_m=z))
    return [*way, *poses]


def _length_m(poses: Sequence[Pose]) -> float:
    return ScanPath(tuple(poses)).length_m


def _evenly(poses: list[Pose], count: int) -> list[Pose]:
    """So many of closely spaced poses, at equal parts of their way."""
    places = np.array([pose.position_m for pose in poses])
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(places, axis=0), axis=1).cumsum()])
    wanted = (np.arange(count) + 0.5) / count * along[-1]
    return [poses[k] for k in np.searchsorted(along, wanted).clip(0, len(poses) - 1)]


def _holds(box: Box, place_m: tuple[float, float, float]) -> bool:
    return all(box.low_m[k] <= place_m[k] <= box.high_m[k] for k in range(2))


def _around(boxes: Sequence[Box]) -> Box:
    low = np.min([box.low_m for box in boxes], axis=0)
    return Box.of(low, np.max([box.high_m for box in boxes], axis=0))
