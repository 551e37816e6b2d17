from __future__ import annotations

import math

import numpy as np

from insonify.types import Float64, Pose
from insonify.vehicle.autopilot.guidance import route_length_m
from insonify.vehicle.autopilot.routing import clear_route, is_clear, nose_first, obstacles_near

START, GOAL = Pose(0.0, 0.0, 0.0), Pose(10.0, 0.0, 0.0, yaw_rad=0.5)


def _wall(x_m: float, low_m: float, high_m: float) -> Float64:
    y, z = np.meshgrid(np.arange(low_m, high_m, 0.1), np.arange(-1.0, 1.0, 0.1))
    return np.column_stack([np.full(y.size, x_m), y.ravel(), z.ravel()])


def test_clearance_is_the_distance_of_the_leg_not_of_its_ends() -> None:
    post = np.array([[5.0, 0.7, 0.0]])
    assert is_clear(START, GOAL, post, 0.69)
    assert not is_clear(START, GOAL, post, 0.71)
    beyond = np.array([[11.0, 0.0, 0.0]])
    assert is_clear(START, GOAL, beyond, 0.9) and not is_clear(START, GOAL, beyond, 1.1)


def test_a_free_way_is_left_as_it_is() -> None:
    middle = Pose(5.0, 1.0, 0.0)
    assert clear_route(START, (middle, GOAL), np.zeros((0, 3)), 0.5) == (middle, GOAL)


def test_a_wall_is_flown_round_and_the_way_is_nearly_the_shortest() -> None:
    wall = _wall(5.0, -2.0, 2.0)
    route = clear_route(START, (GOAL,), wall, 0.6)
    assert route is not None and route[-1] == GOAL
    for a, b in zip((START, *route), route, strict=False):
        assert is_clear(a, b, wall, 0.6)
    # over a corner 0.6 m off the wall's end
    shortest = 2 * math.hypot(5.0, 2.6)
    assert shortest - 0.4 < route_length_m((START, *route)) < 1.15 * shortest


def test_waypoints_inside_an_obstacle_are_left_out_and_a_ring_has_no_way_in() -> None:
    post = np.array([[5.0, 0.0, 0.0]])
    points = tuple(Pose(float(x), 0.0, 0.0) for x in range(1, 10))
    route = clear_route(START, points, post, 0.6)
    assert route is not None
    assert Pose(5.0, 0.0, 0.0) not in route and Pose(9.0, 0.0, 0.0) in route
    angle = np.arange(0.0, math.tau, 0.02)
    ring = np.column_stack([10.0 + 2 * np.cos(angle), 2 * np.sin(angle), 0 * angle])
    assert clear_route(START, (GOAL,), ring, 0.6) is None
    assert clear_route(START, (GOAL,), np.array([[10.0, 0.1, 0.0]]), 0.6) is None


def test_long_legs_are_flown_nose_first_and_end_in_the_heading_asked_for() -> None:
    turned = nose_first(START, (Pose(0.0, 8.0, 0.0, yaw_rad=1.0),))
    assert [round(pose.yaw_rad, 6) for pose in turned] == [1.570796, 1.570796, 1.0]
    assert turned[-1].position_m == turned[-2].position_m
    near = Pose(0.0, 1.0, 0.0, yaw_rad=1.0)
    assert nose_first(START, (near,)) == (near, near)


def test_only_what_is_near_in_height_is_an_obstacle() -> None:
    from insonify.mapping.voxels import BLOCK, VoxelMap

    voxels = VoxelMap(0.5)
    voxels.allocate(np.array([[0, 0, 0]], np.int32))
    voxels.log_odds[0].reshape(BLOCK, BLOCK, BLOCK)[2, 3, :] = 1.0
    route = (Pose(0.0, 0.0, 3.0), Pose(4.0, 4.0, 3.0))
    found = obstacles_near(voxels, route, 0.5)
    assert set(found[:, 2]) == {2.25, 2.75, 3.25, 3.75}
    assert (found[:, :2] == [1.25, 1.75]).all()
    assert len(obstacles_near(voxels, (Pose(0.0, 0.0, 9.0),), 0.5)) == 0
    assert not is_clear(Pose(1.25, 0.0, 3.0), Pose(1.25, 4.0, 3.0), found, 0.5)
