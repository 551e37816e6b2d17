from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.planning.baselines import near_area, path_over_centre
from insonify.planning.decision import SurveyArea
from insonify.planning.rosette import RosettePlanner, RosetteSettings, rosette_around
from insonify.sonar.devices import SonarDevice
from insonify.types import Box, Nav, Pose, StopReason

AREA = SurveyArea(Box((-3, -5, -19.8), (5, 6, -16.5)), -15.0, 0.3, 10.0, 2.0, 40)
GEOMETRY = SonarDevice().geometry


def flown(planner: RosettePlanner) -> list[Pose]:
    poses: list[Pose] = []
    nav, mapper = Nav(None, ()), BayesMapper(MappingSettings())
    while True:
        decision = planner.next_scan(mapper, nav)
        if decision.path is None:
            assert decision.stop is StopReason.PLAN_FLOWN
            return poses
        poses += decision.path.waypoints
        nav = Nav(poses[-1], (*nav.scans, decision.path))


@pytest.mark.parametrize("least_altitude_m", [0.0, 5.2])
@pytest.mark.parametrize("pings", [1, 37, 160])
def test_it_pings_as_often_as_it_may_and_evenly(pings: int, least_altitude_m: float) -> None:
    settings = RosetteSettings(pings=pings, ping_m=0.7)
    poses = flown(RosettePlanner(AREA, GEOMETRY, settings, least_altitude_m))
    assert len(poses) == pings
    steps = [math.dist(a.position_m, b.position_m) for a, b in pairwise(poses)]
    assert max(steps, default=0.7) < 0.8
    assert np.median(steps or [0.7]) == pytest.approx(0.7, abs=0.05)


def test_it_faces_the_object_from_all_sides_and_stays_off_the_region() -> None:
    poses = flown(RosettePlanner(AREA, GEOMETRY, RosetteSettings(pings=300), 5.2))
    x, y, _ = AREA.region.centre_m
    yaws = np.array([pose.yaw_rad for pose in poses])
    for pose in poses:
        ahead = (math.cos(pose.yaw_rad), math.sin(pose.yaw_rad))
        to_centre = (x - pose.x_m, y - pose.y_m)
        assert ahead[0] * to_centre[0] + ahead[1] * to_centre[1] > 0
        aside = abs(ahead[0] * to_centre[1] - ahead[1] * to_centre[0])
        assert aside <= 0.7 * (11 - 8) / 2 + 1e-9  # the axis of the stadium
        inside = -3.6 <= pose.x_m <= 5.6 and -5.6 <= pose.y_m <= 6.6
        assert not inside or pose.z_m >= AREA.region.high_m[2] + 0.1 - 1e-9
    assert np.histogram(yaws, 12, (-math.pi, math.pi))[0].min() > 0


def test_a_level_sonar_goes_round_the_object_at_half_its_height() -> None:
    level = SonarDevice(tilt_deg=0.0).geometry
    poses = flown(RosettePlanner(AREA, level, RosetteSettings(pings=100)))
    for pose in poses:
        assert not (-3 <= pose.x_m <= 5 and -5 <= pose.y_m <= 6)
        assert AREA.region.low_m[2] < pose.z_m < AREA.region.high_m[2]


@pytest.mark.parametrize("tilt_deg", [-90.0, -20.0, 10.0, 89.0])
@pytest.mark.parametrize("range_max_m", [3.0, 60.0])
def test_any_sonar_has_its_rosette(tilt_deg: float, range_max_m: float) -> None:
    geometry = SonarDevice(tilt_deg=tilt_deg, range_max_m=range_max_m).geometry
    shape = rosette_around(AREA, geometry, 0.0)
    assert 0 < shape.near_m <= max(shape.far_m)
    assert len(flown(RosettePlanner(AREA, geometry, RosetteSettings(pings=20)))) == 20


def test_the_near_baselines_begin_within_range_of_the_region() -> None:
    near = near_area(AREA, GEOMETRY, 0.0)
    start = path_over_centre(near, near.heading_rad).waypoints[0]
    first = path_over_centre(AREA, AREA.heading_rad).waypoints[0]
    centre = np.array(AREA.region.centre_m)
    away = [math.dist(pose.position_m[:2], centre[:2]) for pose in (start, first)]
    assert away[0] < away[1]
    assert away[0] <= GEOMETRY.range_max_m
    assert start.z_m > AREA.region.high_m[2]
    assert replace(near, z_m=AREA.z_m, approach_m=AREA.approach_m) == AREA
