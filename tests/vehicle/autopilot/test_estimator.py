"""The filter against the truth: consistent, little drift, and honest when a sensor fails."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from insonify.frames import rotation_from_attitude
from insonify.types import Float64, Pose, StopReason
from insonify.vehicle.autopilot.estimator import STATES
from insonify.vehicle.craft import Craft

Launch = Callable[..., Craft]
SEEDS = 40


def _error(craft: Craft) -> Float64:
    """The true error state (17,)."""
    estimator = craft.estimator
    assert estimator is not None
    state, true = estimator.state, craft._state
    turn = rotation_from_attitude(true[3:7])
    between = rotation_from_attitude(state[6:10]).T @ turn
    angles = 0.5 * np.array(
        [
            between[2, 1] - between[1, 2],
            between[0, 2] - between[2, 0],
            between[1, 0] - between[0, 1],
        ]
    )
    return np.concatenate(
        [
            true[:3] - state[:3],
            turn @ true[7:10] - state[3:6],
            angles,
            craft._imu.bias[3:] - state[10:13],
            craft._imu.bias[:3] - state[13:16],
            [craft._compass.deviation - state[16], craft._dvl.scale - state[17]],
        ]
    )


def test_the_covariance_tells_the_truth(launch: Launch) -> None:
    """NEES over seeds (Bar-Shalom et al. 2001, section 5.4), at three times of a flown corner."""
    corner = (
        Pose(12.0, 0.0, -15.0),
        Pose(12.0, 0.0, -15.0, yaw_rad=math.pi / 2),
        Pose(12.0, 12.0, -16.0, yaw_rad=math.pi / 2),
    )
    sums = np.zeros((3, 2))
    for seed in range(SEEDS):
        craft = launch(seed, current={"velocity_m_s": (0.1, 0.05, 0.0)})
        craft.follower.follow(corner)
        for stage in range(3):
            for _ in range(20 * 18):
                craft.tick()
            error, covariance = _error(craft), craft.estimator.covariance  # type: ignore[union-attr]
            for k, states in enumerate((9, STATES)):
                part = covariance[:states, :states]
                sums[stage, k] += error[:states] @ np.linalg.solve(part, error[:states])
    for k, states in enumerate((9, STATES)):
        low, high = chi2.ppf([0.001, 0.999], SEEDS * states)
        assert (low < sums[:, k]).all() and (sums[:, k] < high).all(), sums / SEEDS


def test_drift_is_under_one_per_cent_of_the_way(launch: Launch) -> None:
    for seed in range(3):
        craft = launch(seed)
        craft.follower.follow((Pose(60.0, 0.0, -15.0),))
        while not craft.follower.finished:
            craft.tick()
        away = math.dist(craft.true_pose.position_m[:2], craft.believed_pose.position_m[:2])
        assert away < 0.01 * craft.track.length_m + 0.05


def test_same_seed_same_flight_and_another_seed_another(launch: Launch) -> None:
    ends = []
    for seed in (1, 1, 2):
        craft = launch(seed)
        for _ in range(100):
            craft.tick()
        ends.append(craft._state.tobytes())
    assert ends[0] == ends[1] != ends[2]


def test_one_beam_still_corrects(launch: Launch) -> None:
    craft = launch()
    assert craft.estimator is not None
    for _ in range(40):
        craft.tick()
    craft.estimator.covariance[3:6, 3:6] += np.eye(3)
    before = craft.estimator.covariance[3:6, 3:6].trace()
    readings = np.array([craft.estimator._beams[0] @ np.zeros(3), math.nan, math.nan, math.nan])
    assert craft.estimator.see_bottom(readings) == 1
    assert craft.estimator.covariance[3:6, 3:6].trace() < before - 0.5


def test_without_bottom_lock_the_vehicle_goes_on_until_it_is_lost(launch: Launch) -> None:
    craft = launch(fault={"sensor": "dvl", "at_s": 10.0})
    while craft.lost is None and craft.time_s < 300.0:
        craft.tick()
    assert craft.lost is StopReason.LOST
    assert craft.time_s > 20.0
    away = math.dist(craft.true_pose.position_m[:2], craft.believed_pose.position_m[:2])
    assert away < 3.5 * craft.estimator.position_sigma_m  # type: ignore[union-attr]


def test_an_imu_without_numbers_ends_navigation_and_spoils_nothing(launch: Launch) -> None:
    craft = launch(fault={"sensor": "imu", "at_s": 2.0})
    while craft.lost is None and craft.time_s < 10.0:
        craft.tick()
    assert craft.lost is StopReason.IMU_FAILED
    assert craft.time_s == pytest.approx(2.0)
    assert craft.estimator is not None and np.isfinite(craft.estimator.state).all()


def test_bad_readings_of_depth_and_heading_are_left_out(launch: Launch) -> None:
    estimator = launch().estimator
    assert estimator is not None
    before = estimator.state.tobytes()
    estimator.see_depth(math.nan)
    estimator.see_heading(math.inf)
    assert estimator.see_bottom(np.full(4, math.nan)) == 0
    assert estimator.state.tobytes() == before
