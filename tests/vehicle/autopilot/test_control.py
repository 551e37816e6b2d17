"""Station keeping and straight lines, flown in a current; and what the integral does at limits."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from insonify.frames import wrapped
from insonify.types import Pose
from insonify.vehicle.autopilot.control import Controller, ControlSettings, Motion, SetPoint
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.model import hydro

Launch = Callable[..., Craft]


@pytest.mark.parametrize("name", ["bluerov2", "cyclops", "rexrov2"])
@pytest.mark.parametrize("bearing_deg", [0.0, 50.0, 90.0])
def test_a_station_is_kept_in_a_current(launch: Launch, name: str, bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    flow = (0.3 * math.cos(bearing), 0.3 * math.sin(bearing), 0.0)
    craft = launch(name=name, navigation="truth", current={"velocity_m_s": flow})
    for _ in range(20 * 30):
        craft.tick()
    for _ in range(20 * 30):
        craft.tick()
        assert math.dist(craft.true_pose.position_m, (0.0, 0.0, -15.0)) < 0.1
        assert abs(math.degrees(craft.true_pose.yaw_rad)) < 2.0


@pytest.mark.parametrize("flow", [(0.0, 0.0, 0.0), (0.0, 0.2, 0.0)])
def test_a_straight_scan_line_is_flown_straight(
    launch: Launch, flow: tuple[float, float, float]
) -> None:
    craft = launch(navigation="truth", current={"velocity_m_s": flow})
    for _ in range(20 * 20):
        craft.tick()
    craft.follower.follow((Pose(17.0, 0.0, -15.0),))
    speeds = []
    while not craft.follower.finished:
        craft.tick()
        pose = craft.true_pose
        assert math.hypot(pose.y_m, pose.z_m + 15.0) < 0.15
        assert abs(math.degrees(pose.yaw_rad)) < 2.5
        if 4.0 < pose.x_m < 13.0:
            speeds.append(craft.true_velocity[0])
    assert np.mean(speeds) == pytest.approx(0.5, abs=0.01)
    assert craft.true_pose.x_m == pytest.approx(17.0, abs=0.1)


def test_a_corner_and_a_turn_on_the_spot(launch: Launch) -> None:
    craft = launch(navigation="truth")
    quarter = math.pi / 2
    corner = Pose(5.0, 0.0, -15.0, yaw_rad=quarter)
    craft.follower.follow((Pose(5.0, 0.0, -15.0), corner, Pose(5.0, 5.0, -16.0, yaw_rad=quarter)))
    for _ in range(20 * 60):
        craft.tick()
    assert craft.follower.finished
    pose = craft.true_pose
    assert math.dist(pose.position_m, (5.0, 5.0, -16.0)) < 0.05
    assert abs(wrapped(pose.yaw_rad - quarter)) < 0.03


def test_the_integral_does_not_wind_up_while_the_thrusters_give_all() -> None:
    """A minute of an error that no thrust can mend leaves no more behind than a second of it."""
    vehicle = vehicle_named("bluerov2")
    still = np.zeros(3)
    goal = SetPoint(still, still, still, 0.0, 0.0, 0.0)

    def after(seconds: float) -> float:
        controller = Controller(vehicle, ControlSettings(), 1025.0)
        far = Motion(np.array([-30.0, 0.0, 0.0]), still, np.eye(3), still, 0.0)
        for _ in range(round(20 * seconds)):
            thrusts = controller.thrusts(far, goal, 0.05)
        assert np.abs(thrusts).max() == pytest.approx(40.0)
        here = Motion(still, still, np.eye(3), still, 0.0)
        thrusts = controller.thrusts(here, goal, 0.05)
        return float(hydro(vehicle, 1025.0).directions[0] @ thrusts)

    assert after(60.0) == pytest.approx(after(30.0), abs=1.0)
    assert after(60.0) > -160.0


def test_the_target_waits_for_a_vehicle_that_cannot_keep_up(launch: Launch) -> None:
    craft = launch(navigation="truth", guidance={"speed_m_s": 3.0})
    craft.follower.follow((Pose(20.0, 0.0, -15.0),))
    for _ in range(20 * 20):
        craft.tick()
        lead = craft.follower.set_point.position_m[0] - craft.true_pose.x_m
        assert lead < 4.0
