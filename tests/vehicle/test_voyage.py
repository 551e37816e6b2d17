"""Scans flown by a vehicle: as missions in their world, and alone against a map."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insonify.io.trajectories import COLUMNS, save_track
from insonify.mapping.voxels import BLOCK, VoxelMap
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.types import FanGeometry, Ping, Pose, PosedPing, ScanPath, StopReason
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.settings import VehicleSettings
from insonify.vehicle.voyage import Surroundings, Voyage

pytestmark = pytest.mark.slow

SMALL: dict[str, Any] = {
    "mapping": {"voxel_m": 0.25},
    "survey": {"approach_m": 4.0, "baseline_scans": 1},
    "sampling": {"over_elevation": 32},
    "planner": "uniform",
}


def _fly(**vehicle: Any) -> Run:
    more = {"vehicle": {"name": "bluerov2", "ping_hz": 1.0, **vehicle}}
    return execute(scenario_config("tetrapod", [SMALL, more]))


def test_a_flown_scan_maps_by_its_estimate_and_is_scored_against_the_truth(tmp_path: Path) -> None:
    run = _fly()
    assert run.stop_reason is StopReason.PLAN_FLOWN
    result = run.result().to_json()
    flown = result["vehicle"]
    assert 20 < run.pings < 40
    assert 0.005 < flown["pose_error"]["position_max_m"] < 0.3
    assert flown["metrics_at_true_poses"] != result["metrics"]
    assert run.flight is not None
    moments = run.flight.track.moments
    assert result["path_m"] == pytest.approx(
        sum(math.dist(a.true.position_m, b.true.position_m) for a, b in pairwise(moments)),
        rel=0.05,
    )
    json.dumps(result)
    save_track(run.flight.track, tmp_path / "trajectory.csv")
    with (tmp_path / "trajectory.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS and len(rows) == len(moments)
    last = moments[-1]
    assert float(rows[-1]["true_x_m"]) == pytest.approx(last.true.x_m)
    assert float(rows[-1]["estimated_yaw_deg"]) == pytest.approx(
        math.degrees(last.estimated.yaw_rad), abs=1e-6
    )
    assert last.covariance is not None
    assert float(rows[-1]["cov_x_yaw"]) == pytest.approx(last.covariance[0, 5])


def test_perfect_navigation_costs_nothing_and_the_same_config_gives_the_same_run() -> None:
    results = []
    for _ in range(2):
        run = _fly(navigation="truth")
        results.append(run.result().to_json() | {"seconds": 0})
        assert run.flight is not None
        same = run.flight.reference.voxels.log_odds.tobytes()
        assert same == run.mapper.voxels.log_odds.tobytes()
    assert results[0] == results[1]
    assert results[0]["vehicle"]["pose_error"]["position_max_m"] == 0.0


@pytest.mark.parametrize(
    ("fault", "reason", "kept"),
    [
        ({"sensor": "imu", "at_s": 10.0}, StopReason.IMU_FAILED, True),
        ({"sensor": "sonar", "at_s": 10.0}, StopReason.SILENT, True),
        ({"sensor": "dvl", "at_s": 5.0}, StopReason.LOST, True),
        ({"sensor": "dvl", "at_s": 25.0}, StopReason.PLAN_FLOWN, True),
        ({"sensor": "sonar", "at_s": 0.0}, StopReason.SILENT, False),
    ],
)
def test_a_sensor_that_fails_ends_the_scan_or_not_and_the_map_is_kept(
    fault: dict[str, Any], reason: StopReason, kept: bool
) -> None:
    run = _fly(fault=fault, lost_m=0.25)
    assert run.stop_reason is reason
    assert (run.mapper.voxels.block_count > 0) == kept
    assert len(run.history) == 1
    assert (run.history[-1].metrics["solid"]["within_one_voxel"]["recall"] > 0.05) == kept


def _voyage(
    voxels: VoxelMap,
    path: ScanPath,
    collides: Callable[[Pose], bool] = lambda pose: False,
    **settings: Any,
) -> tuple[Voyage, list[object]]:
    geometry = FanGeometry(0.5, 0.2, 4, 8, 0.0, 10.0)
    chosen = {"name": "bluerov2", "navigation": "truth", **settings}
    voyage = Voyage(
        vehicle_named("bluerov2"),
        VehicleSettings.model_validate(chosen),
        0.4,
        Surroundings(
            lambda true, believed: Ping(np.zeros((8, 4), np.float32), geometry),
            lambda origin, rays: (np.full(4, 5.0), np.ones(4)),
            collides,
        ),
        np.random.default_rng(0),
    )
    return voyage, list(voyage.carry(path, voxels))


def _post(x: int, y: int) -> VoxelMap:
    """A map with one upright post, a voxel of half a metre wide."""
    voxels = VoxelMap(0.5)
    slots = voxels.allocate(np.array([[x // BLOCK, y // BLOCK, k] for k in range(-4, 0)], np.int32))
    for slot in slots:
        voxels.log_odds[slot].reshape(BLOCK, BLOCK, BLOCK)[x % BLOCK, y % BLOCK, :] = 2.0
    return voxels


LINE = ScanPath(tuple(Pose(float(x), 0.25, -6.0) for x in range(9)))


def test_pings_come_at_their_own_rate_with_the_time_they_were_sent() -> None:
    _, pings = _voyage(VoxelMap(0.5), LINE, ping_hz=4.0)
    times = [one.ping.time_s for one in pings if isinstance(one, PosedPing)]
    np.testing.assert_allclose(np.diff(times)[1:], 0.25, atol=1e-9)
    assert 8.0 / 0.5 * 4 < len(times) < 8.0 / 0.5 * 4 + 40


def test_a_mapped_obstacle_is_flown_round() -> None:
    voyage, pings = _voyage(_post(8, 0), LINE)  # at (4.25, 0.25)
    assert not isinstance(pings[-1], StopReason)
    assert voyage.craft is not None
    nearest = min(
        math.dist(moment.true.position_m[:2], (4.25, 0.25)) for moment in voyage.craft.track.moments
    )
    assert nearest > 0.5
    assert voyage.craft.true_pose.x_m == pytest.approx(8.0, abs=0.2)


def test_an_obstacle_that_is_mapped_on_the_way_is_flown_round_too() -> None:
    voxels = VoxelMap(0.5)
    geometry = FanGeometry(0.5, 0.2, 4, 8, 0.0, 10.0)

    def see(true: Pose, believed: Pose) -> Ping:
        if true.x_m > 1.0 and voxels.block_count == 0:
            known = _post(10, 0)
            slots = voxels.allocate(known.coords)
            voxels.log_odds[slots] = known.log_odds
        return Ping(np.zeros((8, 4), np.float32), geometry)

    settings = VehicleSettings(name="bluerov2", navigation="truth")
    voyage = Voyage(
        vehicle_named("bluerov2"),
        settings,
        0.4,
        Surroundings(see, lambda origin, rays: (np.full(4, 5.0), np.ones(4)), lambda pose: False),
        np.random.default_rng(0),
    )
    pings = list(voyage.carry(LINE, voxels))
    assert not isinstance(pings[-1], StopReason)
    assert voyage.craft is not None
    tracks = [moment.true.position_m[:2] for moment in voyage.craft.track.moments]
    assert min(math.dist(place, (5.25, 0.25)) for place in tracks) > 0.45


def test_flying_into_what_the_map_does_not_know_ends_the_scan() -> None:
    voyage, pings = _voyage(VoxelMap(0.5), LINE, lambda pose: pose.x_m > 4.0)
    assert len(pings) > 5 and pings[-1] is StopReason.COLLISION
    assert voyage.craft is not None
    assert 4.0 < voyage.craft.true_pose.x_m < 4.3


def test_a_scan_that_begins_inside_an_obstacle_has_no_way() -> None:
    _, pings = _voyage(_post(0, 0), ScanPath((Pose(0.25, 0.25, -6.0),)))
    assert pings == [StopReason.NO_WAY]


def test_a_current_too_strong_ends_the_scan_with_its_reason() -> None:
    current = {"velocity_m_s": (-2.5, 0.0, 0.0)}
    _, pings = _voyage(VoxelMap(0.5), LINE, current=current, ping_hz=0.2)
    assert pings[-1] is StopReason.TOO_SLOW


def test_a_scan_of_a_single_waypoint_pings_once_at_least() -> None:
    _, pings = _voyage(VoxelMap(0.5), ScanPath(LINE.waypoints[:1]))
    assert len(pings) >= 1 and not isinstance(pings[-1], StopReason)
