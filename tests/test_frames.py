from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from insonify.errors import GeometryError
from insonify.frames import (
    attitude_from_pose,
    compose,
    directions_from_angles,
    pose_from_attitude,
    pose_from_transform,
    quaternion_from_rotation,
    rotation_from_attitude,
    rotation_from_quaternion,
    rotation_from_rpy,
    slerp,
    std_from_covariance,
    transform_from_pose,
    world_from_sonar,
)
from insonify.types import FanGeometry, Pose

angle = st.floats(-math.pi, math.pi)


@given(angle, angle, angle)
def test_rotation_agrees_with_scipy(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(rotation_from_rpy(roll, pitch, yaw), expected, atol=1e-12)


def test_positive_pitch_and_tilt_point_the_nose_down() -> None:
    down = rotation_from_rpy(0.0, math.radians(30), 0.0) @ [1.0, 0.0, 0.0]
    assert down[2] == pytest.approx(-0.5)
    tilted = world_from_sonar(
        Pose(1, 2, 3, yaw_rad=math.pi / 2), Pose(0, 0, 0, pitch_rad=math.radians(30))
    )
    np.testing.assert_allclose(tilted[:3, 0], [0, math.cos(math.pi / 6), -0.5], atol=1e-12)
    np.testing.assert_allclose(tilted[:3, 3], [1, 2, 3])


@given(angle, st.floats(-math.pi / 2, math.pi / 2), angle)
def test_a_pose_survives_its_transform(roll: float, pitch: float, yaw: float) -> None:
    pose = Pose(1.0, -2.0, 3.0, roll, pitch, yaw)
    again = pose_from_transform(transform_from_pose(pose))
    np.testing.assert_allclose(transform_from_pose(again), transform_from_pose(pose), atol=1e-7)


def test_composed_poses_compose_their_transforms() -> None:
    outer, inner = Pose(1, 2, 3, 0.1, 0.2, 0.3), Pose(-0.5, 0.4, 0.2, 0.3, -0.1, 2.0)
    both = transform_from_pose(compose(outer, inner))
    np.testing.assert_allclose(both, transform_from_pose(outer) @ transform_from_pose(inner))


def test_deviations_are_those_of_the_worst_direction_however_the_axes_lie() -> None:
    turn = rotation_from_rpy(0.4, -0.3, 1.2)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = turn @ np.diag([0.01, 0.25, 0.04]) @ turn.T
    covariance[3:, 3:] = turn @ np.diag([1e-4, 1e-6, 4e-4]) @ turn.T
    assert std_from_covariance(covariance) == pytest.approx((0.5, 0.02))


@pytest.mark.parametrize("first", [0.0, -1.0, math.nan, math.inf])
def test_a_covariance_that_tells_nothing_gives_none(first: float) -> None:
    covariance = np.zeros((6, 6))
    covariance[0, 0] = first
    assert std_from_covariance(covariance) == (0.0, 0.0)


def test_positive_azimuth_is_left_and_positive_elevation_up() -> None:
    left = directions_from_angles(np.array(0.1), np.array(0.0))
    up = directions_from_angles(np.array(0.0), np.array(0.1))
    assert left[1] > 0 and left[2] == 0
    assert up[2] > 0 and up[1] == 0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_pose_refuses_numbers_that_are_not_finite(bad: float) -> None:
    with pytest.raises(GeometryError, match="finite"):
        Pose(0.0, bad, 0.0)


def test_transform_keeps_the_position() -> None:
    np.testing.assert_allclose(transform_from_pose(Pose(1, -2, 3))[:3, 3], [1, -2, 3])


def test_beams_run_from_port_to_starboard() -> None:
    geometry = FanGeometry(math.radians(29), math.radians(14), 96, 513, 0.0, 12.825)
    azimuths = geometry.beam_azimuths_rad
    assert azimuths[0] > 0 > azimuths[-1]
    np.testing.assert_allclose(np.diff(azimuths), -geometry.beam_rad)
    assert geometry.bin_m == pytest.approx(0.025)
    assert geometry.bin_ranges_m[0] == pytest.approx(0.0125)
    assert geometry.bin_ranges_m[-1] == pytest.approx(12.825 - 0.0125)


@given(angle, angle, angle)
def test_quaternions_turn_as_rotation_matrices_do(roll: float, pitch: float, yaw: float) -> None:
    pose = Pose(1.0, 2.0, 3.0, roll, pitch / 2.1, yaw)
    quaternion = attitude_from_pose(pose)
    turn = rotation_from_rpy(roll, pitch / 2.1, yaw)
    np.testing.assert_allclose(rotation_from_attitude(quaternion), turn, atol=1e-12)
    back = pose_from_attitude(np.array([1.0, 2.0, 3.0]), quaternion)
    np.testing.assert_allclose(transform_from_pose(back), transform_from_pose(pose), atol=1e-6)


@given(angle, angle, angle)
def test_quaternions_hold_cosine_and_axis(roll: float, pitch: float, yaw: float) -> None:
    rotation = rotation_from_rpy(roll, pitch, yaw)
    x, y, z, w = quaternion = quaternion_from_rotation(rotation)
    np.testing.assert_allclose(rotation_from_quaternion(3.0 * quaternion), rotation, atol=1e-12)
    # the turn's cosine is in w, its axis in x, y, z
    assert 2.0 * w * w - 1.0 == pytest.approx((np.trace(rotation) - 1.0) / 2.0, abs=1e-9)
    np.testing.assert_allclose(rotation @ [x, y, z], [x, y, z], atol=1e-9)


def test_slerp_takes_the_shorter_way() -> None:
    start, end = (Rotation.from_euler("z", a, degrees=True).as_quat() for a in (-10, 30))
    for sign in (1.0, -1.0):
        middle = rotation_from_quaternion(slerp(start, sign * end, 0.25))
        np.testing.assert_allclose(middle, rotation_from_rpy(0, 0, 0), atol=1e-12)
    np.testing.assert_array_equal(slerp(start, start, 0.5), start)
