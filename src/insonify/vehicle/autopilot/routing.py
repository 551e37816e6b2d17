"""Ways through what the map knows: whether a route keeps clear of it, and a way round if not.

Obstacles are the map's occupied voxels, as points; the vehicle keeps ``clearance_m`` from them.
What the map does not know is no obstacle: the vehicle finds out by flying.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from scipy import ndimage

from insonify.mapping.voxels import VoxelMap
from insonify.types import Bool, Box, Float64, Pose

_TURN_ALONG_M = 2.0
"""Legs at least so long are flown nose first, shorter ones sideways."""


def obstacles_near(voxels: VoxelMap, route: tuple[Pose, ...], clearance_m: float) -> Float64:
    """Occupied voxels (N, 3) within the route's heights, clearance and voxel size added."""
    reach = clearance_m + voxels.voxel_m
    heights = [pose.z_m for pose in route]
    low, high = min(heights) - reach, max(heights) + reach
    layer = Box((-math.inf, -math.inf, low), (math.inf, math.inf, high))
    occupied = voxels.occupied_m(layer)
    near = (occupied[:, 2] > low) & (occupied[:, 2] < high)
    found: Float64 = occupied[near]
    return found


def is_clear(start: Pose, end: Pose, obstacles_m: Float64, clearance_m: float) -> bool:
    """Whether a straight leg keeps its clearance from obstacles (N, 3)."""
    if len(obstacles_m) == 0:
        return True
    a, b = np.array(start.position_m), np.array(end.position_m)
    leg = b - a
    square = float(leg @ leg)
    along = np.zeros(len(obstacles_m))
    if square > 0.0:
        along = np.clip((obstacles_m - a) @ leg / square, 0.0, 1.0)
    nearest = np.linalg.norm(obstacles_m - a - along[:, None] * leg, axis=1)
    return bool(nearest.min() >= clearance_m)


def clear_route(
    start: Pose, waypoints: tuple[Pose, ...], obstacles_m: Float64, clearance_m: float
) -> tuple[Pose, ...] | None:
    """Waypoints and what leads round obstacles between them; waypoints too near one are left out.

    Returns:
        The route after ``start``, or None if no waypoint can be reached.
    """
    route: list[Pose] = []
    here = start
    for waypoint in waypoints:
        if not is_clear(waypoint, waypoint, obstacles_m, clearance_m):
            continue
        if is_clear(here, waypoint, obstacles_m, clearance_m):
            route.append(waypoint)
        else:
            around = _way_round(here, waypoint, obstacles_m, clearance_m)
            if around is None:
                continue
            route += around
        here = waypoint
    return tuple(route) or None


def transit(start: Pose, goal: Pose) -> tuple[Pose, ...]:
    """A leg to a pose: nose first if it is long, then the turn to the pose's own heading."""
    return nose_first(start, (goal,))


def nose_first(start: Pose, route: tuple[Pose, ...]) -> tuple[Pose, ...]:
    """A route whose long legs are flown nose first, and its last heading taken at its end."""
    turned: list[Pose] = []
    here = start
    for pose in route:
        leg = math.hypot(pose.x_m - here.x_m, pose.y_m - here.y_m)
        yaw = math.atan2(pose.y_m - here.y_m, pose.x_m - here.x_m)
        if leg >= _TURN_ALONG_M:
            turned.append(Pose(here.x_m, here.y_m, here.z_m, yaw_rad=yaw))
            turned.append(Pose(pose.x_m, pose.y_m, pose.z_m, yaw_rad=yaw))
        else:
            turned.append(pose)
        here = pose
    return (*turned, route[-1])


def _way_round(
    start: Pose, goal: Pose, obstacles_m: Float64, clearance_m: float
) -> list[Pose] | None:
    """The shortest way at the goal's height over a grid (A*), straightened where it can be."""
    cell = clearance_m / 3
    ends = np.array([start.position_m[:2], goal.position_m[:2]])
    around = np.vstack([ends, obstacles_m[:, :2]])
    corner = around.min(axis=0) - 3 * clearance_m
    shape = np.ceil((around.max(axis=0) + 3 * clearance_m - corner) / cell).astype(int) + 1
    grid = np.zeros(shape, bool)
    index = ((obstacles_m[:, :2] - corner) / cell).astype(int)
    grid[index[:, 0], index[:, 1]] = True
    free = ndimage.distance_transform_edt(~grid) * cell > clearance_m + 1.5 * cell
    first, last = (tuple(int(c) for c in (end - corner) / cell) for end in ends)
    free[first] = free[last] = True
    areas, _ = ndimage.label(free, structure=np.ones((3, 3)))
    if areas[first] != areas[last]:
        return None  # as the search would find after all that can be reached
    cells = _shortest(free, (first[0], first[1]), (last[0], last[1]))
    if cells is None:
        return None
    places = corner + (np.array(cells) + 0.5) * cell
    poses = [Pose(float(x), float(y), goal.z_m, yaw_rad=goal.yaw_rad) for x, y in places[1:-1]]
    poses.append(goal)
    return _straightened(start, poses, obstacles_m, clearance_m)


def _straightened(
    start: Pose, poses: list[Pose], obstacles_m: Float64, clearance_m: float
) -> list[Pose] | None:
    """Leave out every pose that a clear straight leg makes needless."""
    kept: list[Pose] = []
    here, k = start, 0
    while k < len(poses):
        ahead = range(len(poses) - 1, k - 1, -1)
        far = next((j for j in ahead if is_clear(here, poses[j], obstacles_m, clearance_m)), None)
        if far is None:
            return None
        here, k = poses[far], far + 1
        kept.append(here)
    return kept


def _shortest(
    free: Bool, start: tuple[int, int], goal: tuple[int, int]
) -> list[tuple[int, int]] | None:
    """A* over the free cells of a grid, eight neighbours."""
    moves = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    cost = {start: 0.0}
    came: dict[tuple[int, int], tuple[int, int]] = {}
    queue = [(math.dist(start, goal), start)]
    closed: set[tuple[int, int]] = set()
    while queue:
        _, here = heapq.heappop(queue)
        if here == goal:
            way = [here]
            while here in came:
                here = came[here]
                way.append(here)
            return way[::-1]
        if here in closed:
            continue
        closed.add(here)
        for i, j in moves:
            cell = (here[0] + i, here[1] + j)
            inside = 0 <= cell[0] < free.shape[0] and 0 <= cell[1] < free.shape[1]
            if not inside or not free[cell]:
                continue
            length = cost[here] + math.hypot(i, j)
            if length < cost.get(cell, math.inf):
                cost[cell], came[cell] = length, here
                heapq.heappush(queue, (length + math.dist(cell, goal), cell))
    return None
