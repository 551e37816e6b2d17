"""Search, finds, obstacles, and the planner that looks at what it found."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.planning.decision import SurveyArea
from insonify.planning.finds import Obstacles, find_in, find_of, outstanding
from insonify.planning.information import InformationPlanner, InformationSettings
from insonify.planning.rosette import rosette_around
from insonify.planning.sweep import seabed_in_view_m, sweep
from insonify.sonar.devices import SonarDevice
from insonify.types import Box, Nav, Pose, StopReason

SMALL_FIELD: dict[str, Any] = {
    "planner": "information",
    "seed": 2,
    "field": {"count": 2, "size_m": 17.0, "kinds": ["boxes", "tower"], "apart_m": 1.0},
    "seabed": {"size_m": 60.0},
    "mapping": {"voxel_m": 0.25},
    "sonar": {"beams": 24, "bins": 160, "range_max_m": 8.0},
    "sampling": {"across_beam": 2, "over_elevation": 48},
}
PINGS = 900
LARGE = SurveyArea(Box((-10, -20, -19.8), (30, 12, -16.5)), -15.0, 0.0, 8.0, 2.0, 40)
SONARS = {
    "park": SonarDevice(),
    "wide": SonarDevice(azimuth_fov_deg=130.0, elevation_fov_deg=20.0, range_max_m=20.0),
    "level": SonarDevice(tilt_deg=0.0),
    "down": SonarDevice(tilt_deg=80.0, azimuth_fov_deg=90.0),
    "short": SonarDevice(range_max_m=6.0),
}


def small_field(pings: int) -> Run:
    return execute(scenario_config("field", [SMALL_FIELD, {"information": {"pings": pings}}]))


def searched(run: Run) -> int:
    """How many tracks the search has."""
    planner = run.world.planner()
    assert isinstance(planner, InformationPlanner)
    return len(planner.search)


@pytest.fixture(scope="module")
def flown() -> Run:
    return small_field(PINGS)


def test_it_finds_the_objects_and_looks_at_each(flown: Run) -> None:
    boxes = outstanding(flown.mapper.voxels, flown.world.area.region)
    for body in flown.world.stage.bodies:
        x, y, _ = body.box.centre_m
        assert any(
            box.low_m[0] < x < box.high_m[0] and box.low_m[1] < y < box.high_m[1] for box in boxes
        ), body.name
        bearings = [
            (math.atan2(y - pose.y_m, x - pose.x_m), pose.yaw_rad)
            for path in flown.paths
            for pose in path.waypoints
            if math.dist((pose.x_m, pose.y_m), (x, y)) < 7.0
        ]
        facing = [b for b, yaw in bearings if abs(math.remainder(b - yaw, math.tau)) < 0.25]
        sides = np.histogram(facing, 8, (-math.pi, math.pi))[0]
        assert np.count_nonzero(sides) >= 4, body.name
    f1 = [row.metrics["solid"]["exact"]["f1"] for row in flown.history]
    assert len(f1) > searched(flown)
    assert f1[-1] > f1[searched(flown) - 1] + 0.05


def test_its_route_is_whole_and_keeps_clear_of_everything(flown: Run) -> None:
    poses = [pose for path in flown.paths for pose in path.waypoints]
    legs = [math.dist(a.position_m, b.position_m) for a, b in pairwise(poses)]
    assert flown.path_m == pytest.approx(sum(legs))
    tracks = sum(len(path.waypoints) for path in flown.paths[: searched(flown)])
    assert max(legs[tracks:]) < 2.0 * flown.config.information.ping_m  # also between two looks
    for path in flown.paths:
        clearance_m = flown.config.survey.clearance_m
        assert flown.world.scene.first_collision(path, clearance_m) is None


def test_the_same_seed_flies_the_same_way_and_stops_when_its_pings_are_used_up(flown: Run) -> None:
    assert flown.stop_reason is StopReason.PLAN_FLOWN
    assert flown.pings == PINGS
    again = small_field(PINGS - 150)
    assert [pose for path in again.paths for pose in path.waypoints] == [
        pose for path in flown.paths for pose in path.waypoints
    ][: PINGS - 150]
    assert again.history[:-1] == flown.history[: len(again.history) - 1]


def test_it_stops_when_its_metres_are_used_up() -> None:
    planner = InformationPlanner(LARGE, SONARS["park"].geometry, InformationSettings(path_m=20.0))
    mapper = BayesMapper(MappingSettings(voxel_m=0.4))
    path = planner.next_scan(mapper, Nav(None, ())).path
    assert path is not None
    assert 19.0 < path.length_m <= 20.0
    decision = planner.next_scan(mapper, Nav(path.waypoints[-1], (path,)))
    assert decision.stop is StopReason.PLAN_FLOWN


def test_a_find_is_left_when_a_look_changes_little_of_it() -> None:
    region = Box((-3, -3, -19.8), (3, 3, -17.0))
    area = SurveyArea(region, -15.0, 0.0, 4.0, 2.0, 10)
    voxels = _map([((x, y, -25), 1.0) for x in (-1, 0) for y in (-1, 0)])
    mapper = BayesMapper(MappingSettings(voxel_m=0.1))
    mapper.voxels = voxels
    planner = InformationPlanner(area, SONARS["park"].geometry, InformationSettings())
    first = planner.next_scan(mapper, Nav(None, ())).path
    assert first is not None
    nav = Nav(first.waypoints[-1], (first,))
    voxels.log_odds[0] = -1.0  # a quarter of it is gone: worth another look
    second = planner.next_scan(mapper, nav).path
    assert second is not None
    nav = Nav(second.waypoints[-1], (first, second))
    assert planner.next_scan(mapper, nav).stop is StopReason.LITTLE_LEFT  # nothing changed


def test_a_small_area_needs_no_search_and_an_object_grows_beyond_it() -> None:
    region = Box((-3, -3, -19.8), (3, 3, -17.0))
    area = SurveyArea(region, -15.0, 0.0, 4.0, 2.0, 10)
    mapper = BayesMapper(MappingSettings(voxel_m=0.1))
    mapper.voxels = _map([((x, 0, -25), 2.0) for x in range(-2, 12)])
    planner = InformationPlanner(area, SONARS["park"].geometry, InformationSettings())
    assert planner.search == ()
    nav, reached = Nav(None, ()), []
    for _ in range(3):
        path = planner.next_scan(mapper, nav).path
        assert path is not None
        nav = Nav(path.waypoints[-1], (*nav.scans, path))
        (find, _), *_ = planner.open_finds(mapper)
        reached.append(find.box.high_m[0])
        mapper.voxels.log_odds[: len(reached)] *= -1.0  # something changes, so it goes on
    assert reached[0] < 4.0 < reached[1] < reached[2]


@pytest.mark.parametrize("name", SONARS)
def test_a_sweep_has_all_the_area_in_view(name: str) -> None:
    """Points of the seabed, or if its axis does not come so low, of the water where it does."""
    geometry = SONARS[name].geometry
    shape = rosette_around(LARGE, geometry, 0.0)
    z_m = max(shape.top_m, shape.over_m)
    deep_m = max(0.85 * geometry.range_max_m * math.sin(geometry.tilt_rad), 0.5)
    low_m = max(-20.0, z_m - deep_m)
    x, y = np.meshgrid(np.arange(-9.5, 30.0, 1.0), np.arange(-19.5, 12.0, 1.0))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, low_m)])
    poses = [pose for path in sweep(LARGE, geometry, z_m, 0.7) for pose in path.waypoints]
    seen = BayesMapper(MappingSettings(voxel_m=0.4)).tells(poses, geometry, points).any(axis=0)
    assert seen.mean() > 0.97, name


def test_the_seabed_in_view_is_what_the_fan_meets() -> None:
    near_m, far_m = seabed_in_view_m(SONARS["park"].geometry, 5.0)
    assert near_m == pytest.approx(5.0 / math.tan(math.radians(37.0)))
    assert far_m == pytest.approx(math.sqrt((0.92 * 12.825) ** 2 - 25.0))
    assert seabed_in_view_m(SONARS["level"].geometry, 1.0)[0] == pytest.approx(
        1.0 / math.tan(math.radians(7.0))
    )


def _map(blocks: list[tuple[tuple[int, int, int], float]]) -> VoxelMap:
    """Blocks of 0.8 m, each of one value, all observed."""
    voxels = VoxelMap(0.1)
    slots = voxels.allocate(np.array([place for place, _ in blocks], np.int32))
    voxels.log_odds[slots] = np.array([[value] for _, value in blocks], np.float32)
    voxels.seen[slots] = IN_VIEW | OBSERVED
    return voxels


def test_what_stands_out_is_told_by_what_is_usual() -> None:
    region = Box((-8, -8, 0), (8, 8, 3.2))
    floor = [((x, y, 0), 0.05) for x in range(-10, 10) for y in range(-10, 10)]
    wall = [((4, y, z), 1.0) for y in (-2, -1) for z in (0, 1)]
    odd = dict(floor) | dict(wall)
    (box,) = outstanding(_map(list(odd.items())), region)
    assert box.low_m == pytest.approx((3.2 - 0.5, -1.6 - 0.5, 0.0))
    assert box.high_m == pytest.approx((4.0 + 0.5, 0.5, 1.6 + 0.5))
    assert outstanding(VoxelMap(0.1), region) == []


def test_a_find_goes_on_beyond_the_region_where_something_was_looked_at() -> None:
    region = Box((0, 0, 0), (4, 4, 1.6))
    voxels = _map([((x, 1, 0), 2.0) for x in range(3, 9)])
    (inside,) = outstanding(voxels, region)
    (beyond,) = outstanding(voxels, region, [Box((2, 0, 0), (6, 3, 1.6))])
    assert inside.high_m[0] == pytest.approx(4.5)
    assert beyond.high_m[0] == pytest.approx(6.5)


def test_doubt_is_how_many_voxels_are_expected_to_be_held_wrongly() -> None:
    voxels = _map([((0, 0, 0), math.log(3.0)), ((1, 0, 0), -math.log(9.0))])
    find = find_in(voxels, Box((0, 0, 0), (1.6, 0.8, 0.8)))
    assert find.doubt == pytest.approx(512 * 0.25 + 512 * 0.1, rel=1e-4)
    assert np.count_nonzero(find.held) == 512
    whole = find_in(voxels, Box((-8, -8, 0), (8, 8, 4)))
    assert len(whole.voxels_m) <= 1600
    assert whole.doubts.sum() == pytest.approx(whole.doubt, rel=0.05)
    both = find_of(Box((0, 0, 0), (9, 9, 9)), [find, whole])
    assert both.doubt == find.doubt + whole.doubt
    assert len(both.held) == len(find.held) + len(whole.held)


def test_paths_are_raised_over_what_is_mapped_and_what_is_not_known() -> None:
    region = Box((-4, -4, 0), (4, 4, 4))
    free = [((x, y, z), -3.0) for x in range(-7, 7) for y in range(-7, 7) for z in range(5)]
    pillar = ((1, 0, 0), 3.0)
    voxels = _map([one for one in free if one[0] != pillar[0]] + [pillar])
    line = [Pose(x, 0.4, 0.5) for x in np.arange(-6.0, 6.01, 0.1).tolist()]
    over = Obstacles(voxels, region, 0.4, 3.0).over(line)
    heights = {round(pose.x_m, 1): pose.z_m for pose in over}
    assert heights[1.2] == pytest.approx(0.8 + 0.4)  # over it
    assert heights[-6.0] == heights[6.0] == 0.5
    climbs = [abs(b.z_m - a.z_m) for a, b in pairwise(over)]
    assert max(climbs) <= 0.1 + 1e-9
    assert [(p.x_m, p.y_m) for p in over] == [(p.x_m, p.y_m) for p in line]
    unknown = Obstacles(VoxelMap(0.1), region, 0.4, 3.0).over(line)
    inside = [pose.z_m for pose in unknown if abs(pose.x_m) < 4.0]
    assert min(inside) >= 4.4 - 1e-9
    assert unknown[0].z_m < 4.0


@pytest.mark.parametrize("name", SONARS)
def test_any_sonar_has_a_first_scan(name: str) -> None:
    settings, mapper = InformationSettings(), BayesMapper(MappingSettings(voxel_m=0.4))
    small = SurveyArea(Box((-3, -2, -19.8), (3, 2, -16.5)), -15.0, 0.0, 8.0, 2.0, 20)
    for area in (LARGE, small):
        planner = InformationPlanner(area, SONARS[name].geometry, settings)
        path = planner.next_scan(mapper, Nav(None, ())).path
        assert path is not None
        for pose in path.waypoints:
            assert -20.0 < pose.z_m < 0.0
