"""Equations 3 to 9, and the decisions built from them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from insonify.frames import world_from_sonar
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import BLOCK, IN_VIEW, OBSERVED, VoxelMap
from insonify.planning.active import Counted, EntropyPlanner, EntropySettings, Standoff
from insonify.planning.baselines import LawnmowerPlanner, UniformPlanner, path_over_centre
from insonify.planning.candidates import candidate_poses, standoff_radius, straight_path
from insonify.planning.clusters import Cluster
from insonify.planning.decision import Decision, SurveyArea
from insonify.planning.entropy import binary_entropy, entropy_map, high_entropy_voxels
from insonify.planning.gain import expected_gain
from insonify.sonar.devices import SonarDevice
from insonify.types import Box, Nav, Pose, ScanPath, StopReason

GEOMETRY = SonarDevice().geometry
AREA = SurveyArea(Box((-4.0, -4.0, 0.0), (4.0, 4.0, 3.0)), 5.0, 0.0, 8.0, 2.0, 5)


def _cluster(centre: tuple[float, float, float], radius: float = 1.0) -> Cluster:
    return Cluster(np.array([centre]), np.ones(1, np.float32), centre, radius, 1.0)


def test_equation_3_is_the_entropy_of_a_coin() -> None:
    p = np.array([0.0, 0.11, 0.25, 0.5, 0.9, 1.0], np.float32)
    expected = [stats.entropy([q, 1 - q], base=2) for q in p]
    np.testing.assert_allclose(binary_entropy(p), expected, atol=1e-6)
    assert binary_entropy(np.array([0.25], np.float32))[0] == pytest.approx(0.8112781)


def test_high_entropy_needs_a_look() -> None:
    voxels = VoxelMap(1.0)
    voxels.allocate(np.zeros((1, 3), np.int32))
    voxels.seen[0, :3] = IN_VIEW, IN_VIEW | OBSERVED, IN_VIEW | OBSERVED
    voxels.log_odds[0, 1:3] = 0.1, 2.0
    window = voxels.window(Box((0, 0, 0), (1, 1, 8)))
    entropy = entropy_map(window)
    assert entropy[0, 0, 5] == 1.0
    assert high_entropy_voxels(window, entropy, 0.99)[0, 0].tolist() == [True, True] + 6 * [False]


def test_equations_4_and_5_by_hand() -> None:
    poses = candidate_poses(_cluster((1.0, 2.0, 0.5)), 3.0, 5.0, 4)
    expected = [(4, 2, math.pi), (1, 5, -math.pi / 2), (-2, 2, 0.0), (1, -1, math.pi / 2)]
    for pose, (x, y, yaw) in zip(poses, expected, strict=True):
        assert (pose.x_m, pose.y_m, pose.z_m) == pytest.approx((x, y, 5.0))
        assert math.cos(pose.yaw_rad) == pytest.approx(math.cos(yaw), abs=1e-12)
        assert math.sin(pose.yaw_rad) == pytest.approx(math.sin(yaw), abs=1e-12)


def test_standoff_puts_the_centre_on_the_sonars_axis() -> None:
    cluster = _cluster((1.0, 2.0, 1.0))
    radius = standoff_radius(cluster, 5.0, GEOMETRY)
    assert radius == pytest.approx(4.0 / math.tan(math.radians(30)))
    for pose in candidate_poses(cluster, radius, 5.0, 7):
        axis = world_from_sonar(pose, GEOMETRY.mount)[:3, 0]
        towards = np.subtract(cluster.centre_m, pose.position_m)
        np.testing.assert_allclose(axis, towards / np.linalg.norm(towards), atol=1e-12)
    assert standoff_radius(_cluster((0, 0, 1.0), 30.0), 5.0, GEOMETRY) == 30.0
    deep = standoff_radius(_cluster((0, 0, -3.0)), 5.0, GEOMETRY)
    assert math.hypot(deep, 8.0) <= GEOMETRY.range_max_m


def test_equation_8_is_linear_interpolation_with_fixed_heading() -> None:
    path = straight_path(Pose(0.0, 0.0, 5.0, yaw_rad=0.3), (4.0, -8.0), 5)
    assert [(p.x_m, p.y_m) for p in path.waypoints] == [(0, 0), (1, -2), (2, -4), (3, -6), (4, -8)]
    assert {(p.z_m, p.yaw_rad) for p in path.waypoints} == {(5.0, 0.3)}
    assert path.length_m == pytest.approx(math.hypot(4, 8))
    assert len(straight_path(Pose(0, 0, 5.0), (1.0, 1.0), 1).waypoints) == 1


def test_equation_6_against_brute_force(rng: np.random.Generator) -> None:
    walls = _walls(rng.uniform([4, -3, 0], [11, 3, 4], (60, 3)))
    occupied = walls.voxels.occupied_m()
    voxels = rng.uniform([2, -4, 0], [12, 4, 4], (3000, 3))
    entropy = rng.random(3000).astype(np.float32)
    poses = [Pose(0, 0, 5.0), Pose(0, 1, 5.0, yaw_rad=-0.2), Pose(12, 0, 5.0, yaw_rad=math.pi)]
    expected = []
    for pose in poses:
        transform = world_from_sonar(pose, GEOMETRY.mount)

        def polar(points: np.ndarray, transform: np.ndarray = transform) -> tuple[np.ndarray, ...]:
            p = (points - transform[:3, 3]) @ transform[:3, :3]
            r = np.linalg.norm(p, axis=1)
            azimuth = np.arctan2(p[:, 1], p[:, 0])
            inside = (
                (np.abs(azimuth) <= GEOMETRY.azimuth_fov_rad / 2)
                & (np.abs(np.arcsin(p[:, 2] / r)) <= GEOMETRY.elevation_fov_rad / 2)
                & (r <= GEOMETRY.range_max_m)
            )
            return r, (GEOMETRY.azimuth_fov_rad / 2 - azimuth) / GEOMETRY.beam_rad, inside

        nearest = np.full(GEOMETRY.beams, np.inf)
        for r, column, inside in zip(*polar(occupied), strict=True):
            spread = 0.05 / r / GEOMETRY.beam_rad
            for beam in range(GEOMETRY.beams):
                if inside and math.floor(column - spread) <= beam <= math.floor(column + spread):
                    nearest[beam] = min(nearest[beam], r)
        total = 0.0
        for r, column, inside, bits in zip(*polar(voxels), entropy, strict=True):
            if inside and r < nearest[min(int(column), GEOMETRY.beams - 1)]:
                total += float(bits)
        expected.append(total)
    found = expected_gain(walls, poses, GEOMETRY, voxels, entropy)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert found.min() > 0
    clear = expected_gain(_walls(np.empty((0, 3))), poses, GEOMETRY, voxels, entropy)
    assert (clear > found).all()


def _believing(voxels: VoxelMap) -> BayesMapper:
    return BayesMapper(MappingSettings(voxel_m=voxels.voxel_m), voxels)


def _walls(occupied_m: np.ndarray) -> BayesMapper:
    """A map in which the voxels at some points are occupied."""
    voxels = VoxelMap(0.1)
    for index in np.floor(occupied_m / 0.1 + 1e-9).astype(np.int64):
        (slot,) = voxels.allocate((index // BLOCK)[None].astype(np.int32))
        voxels.log_odds[slot].reshape((BLOCK,) * 3)[tuple(index % BLOCK)] = 2.0
    return _believing(voxels)


def _map_with_doubt(visible: bool = True) -> BayesMapper:
    """A block of undecided voxels in front of which there is, or is not, a wall all around."""
    voxels = VoxelMap(0.25)
    grid = np.array([[x, y, z] for x in range(-3, 3) for y in range(-3, 3) for z in range(3)])
    voxels.allocate(grid.astype(np.int32))
    cells = np.column_stack(np.unravel_index(np.arange(BLOCK**3), (BLOCK,) * 3))
    centres = (voxels.coords[:, None, :] * BLOCK + cells + 0.5) * 0.25
    inside = (np.abs(centres[..., :2]) < 1.0).all(axis=-1) & (np.abs(centres[..., 2] - 1) < 0.6)
    voxels.seen[inside] = IN_VIEW
    if not visible:
        flat = np.hypot(centres[..., 0], centres[..., 1])
        wall = (flat > 2.0) & (flat < 2.6)
        voxels.log_odds[wall] = 3.0
        voxels.seen[wall] = IN_VIEW | OBSERVED
    return _believing(voxels)


NAV = Nav(Pose(0, 0, 5.0), (ScanPath((Pose(0, 0, 5.0),)),))


def test_equation_7_flies_from_the_best_candidate_to_the_centre() -> None:
    planner = EntropyPlanner(AREA, GEOMETRY, EntropySettings(termination=0.1))
    decision = planner.next_scan(_map_with_doubt(), NAV)
    look, path = decision.look, decision.path
    assert look is not None and path is not None
    assert len(look.candidates) == 20
    assert look.best == int(np.argmax(look.h_sum))
    assert path.waypoints[0] == look.candidates[look.best]
    assert (path.waypoints[-1].x_m, path.waypoints[-1].y_m) == pytest.approx(
        look.cluster.centre_m[:2]
    )
    assert len(path.waypoints) == AREA.waypoints


def test_equation_9_stops_when_no_candidate_is_worth_it() -> None:
    walled = _map_with_doubt(visible=False)
    planner = EntropyPlanner(AREA, GEOMETRY, EntropySettings(termination=0.3))
    decision = planner.next_scan(walled, NAV)
    assert decision.stop is StopReason.NOT_WORTH_IT
    assert decision.look is not None
    assert (decision.look.h_cluster <= 0.3 * decision.look.cluster.entropy).all()
    best = decision.look.h_cluster.max() / decision.look.cluster.entropy
    never = EntropyPlanner(AREA, GEOMETRY, EntropySettings(termination=min(1.0, best + 1e-9)))
    assert never.next_scan(walled, NAV).stop is StopReason.NOT_WORTH_IT
    if best > 0:
        eager = EntropyPlanner(AREA, GEOMETRY, EntropySettings(termination=best * 0.99))
        assert eager.next_scan(walled, NAV).path is not None


def test_equation_9_goes_on_while_a_single_candidate_pays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import insonify.planning.active as active

    def one_sees_much(belief: object, poses: list[Pose], *_: object) -> np.ndarray:
        bits = np.zeros(len(poses))
        bits[7] = 1e9
        return bits

    monkeypatch.setattr(active, "expected_gain", one_sees_much)
    decision = EntropyPlanner(AREA, GEOMETRY, EntropySettings()).next_scan(_map_with_doubt(), NAV)
    assert decision.look is not None and decision.look.best == 7
    assert decision.path is not None and decision.path.waypoints[0] == decision.look.candidates[7]


def test_equation_6_stops_before_the_first_occupied_voxel() -> None:
    pose = Pose(0, 0, 0)
    axis = world_from_sonar(pose, GEOMETRY.mount)[:3, 0]
    at = np.array([axis * r for r in (5.0, 6.0, 7.0)])
    bits = np.array([1.0, 2.0, 4.0], np.float32)
    wall = _walls(at[1:2])
    near = wall.voxels.occupied_m()[0]
    at = np.array([near - axis, near, near + axis])
    assert expected_gain(wall, [pose], GEOMETRY, at, bits)[0] == 1.0


def test_a_first_scan_starts_before_the_region_along_its_heading() -> None:
    area = SurveyArea(Box((-1.0, -5.0, 0.0), (1.0, 5.0, 3.0)), 5.0, math.pi / 2, 8.0, 2.0, 5)
    start, end = (path_over_centre(area, area.heading_rad).waypoints[k] for k in (0, -1))
    assert (start.x_m, start.y_m, end.y_m) == pytest.approx((0.0, -13.0, 2.0))


def test_other_reasons_to_stop() -> None:
    planner = EntropyPlanner(AREA, GEOMETRY, EntropySettings(termination=0.0, max_scans=1))
    assert planner.next_scan(_believing(VoxelMap(0.25)), NAV).stop is StopReason.NO_CLUSTER
    assert planner.next_scan(_map_with_doubt(), NAV).stop is StopReason.SCAN_LIMIT


def test_the_papers_literal_rules_are_settings() -> None:
    literal = EntropySettings(standoff=Standoff.CLUSTER, counted=Counted.REGION, termination=0.0)
    decision = EntropyPlanner(AREA, GEOMETRY, literal).next_scan(_map_with_doubt(), NAV)
    look = decision.look
    assert look is not None
    first, centre = look.candidates[0], look.cluster.centre_m
    assert math.dist((first.x_m, first.y_m), centre[:2]) == pytest.approx(look.cluster.radius_m)
    assert (look.h_sum >= look.h_cluster - 1e-6).all()


def test_first_scan_passes_over_the_centre() -> None:
    planner = EntropyPlanner(AREA, GEOMETRY, EntropySettings())
    path = planner.next_scan(_believing(VoxelMap(0.25)), Nav(None, ())).path
    assert path == path_over_centre(AREA, 0.0)
    assert path is not None
    assert (path.waypoints[0].x_m, path.waypoints[-1].x_m) == pytest.approx((-12.0, 2.0))


def _fly(planner: UniformPlanner | LawnmowerPlanner) -> list[ScanPath]:
    scans: tuple[ScanPath, ...] = ()
    while True:
        decision = planner.next_scan(_believing(VoxelMap(1.0)), Nav(None, scans))
        if decision.path is None:
            assert decision.stop is StopReason.PLAN_FLOWN
            return list(scans)
        scans = (*scans, decision.path)


def test_uniform_divides_the_circle_and_crosses_the_centre() -> None:
    scans = _fly(UniformPlanner(AREA, 3))
    yaws = [path.waypoints[0].yaw_rad for path in scans]
    np.testing.assert_allclose(np.diff(yaws), 2 * math.pi / 3)
    for path in scans:
        a, b = path.waypoints[0], path.waypoints[-1]
        cross = (b.x_m - a.x_m) * a.y_m - (b.y_m - a.y_m) * a.x_m
        assert cross == pytest.approx(0.0, abs=1e-9)
        assert math.atan2(b.y_m - a.y_m, b.x_m - a.x_m) == pytest.approx(
            math.remainder(a.yaw_rad, 2 * math.pi)
        )


def test_lawnmower_tracks_are_parallel_to_and_fro_and_divide_the_width() -> None:
    scans = _fly(LawnmowerPlanner(AREA, 4))
    assert [path.waypoints[0].y_m for path in scans] == pytest.approx([-3, -1, 1, 3])
    assert [round(math.cos(path.waypoints[0].yaw_rad)) for path in scans] == [1, -1, 1, -1]
    for path in scans:
        reach = GEOMETRY.range_max_m * math.cos(math.radians(23))
        assert abs(path.waypoints[0].x_m) == pytest.approx(12.0)
        assert abs(path.waypoints[0].x_m) - AREA.region.high_m[0] < reach


def test_a_decision_is_a_path_or_a_reason() -> None:
    with pytest.raises(ValueError, match="either"):
        Decision()
