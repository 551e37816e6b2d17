from __future__ import annotations

import math

import pytest

from insonify.errors import GeometryError
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import Belief, MappingSettings
from insonify.mission.loop import Decided, Ended, Mapped, Pinged, Scanned
from insonify.mission.run import execute
from insonify.mission.setup import Config, World, scenario_config
from insonify.planning.baselines import path_over_centre
from insonify.planning.decision import Decision
from insonify.types import Nav, Ping, Pose, ScanPath, StopReason

SMALL = {
    "mapping": {"voxel_m": 0.25},
    "survey": {"waypoints": 6},
    "sampling": {"over_elevation": 64},
}


def _config(**more: object) -> Config:
    return scenario_config("tetrapod", [SMALL, more])


class FromTheSouth:
    """A user's own planner."""

    name = "from-the-south"

    def __init__(self, world: World, scans: int = 2) -> None:
        self.area, self.scans = world.area, scans

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        if len(nav.scans) == self.scans:
            return Decision(stop=StopReason.PLAN_FLOWN)
        return Decision(path=path_over_centre(self.area, math.pi / 2))


def test_a_users_planner_plugs_in_and_the_steps_come_in_order() -> None:
    config = _config()
    steps: list[type] = []
    run = execute(
        config, FromTheSouth(World(config)), watch=lambda run, step: steps.append(type(step))
    )
    scan = [Decided] + [Pinged, Mapped] * 6 + [Scanned]
    assert steps == scan + scan + [Decided, Ended]
    result = run.result().to_json()
    assert (result["planner"], result["scans"], result["pings"]) == ("from-the-south", 2, 12)
    assert result["stop_reason"] == StopReason.PLAN_FLOWN.value
    assert [entry["pings"] for entry in result["history"]] == [6, 12]
    path = path_over_centre(World(config).area, math.pi / 2)
    transit = math.dist(path.waypoints[0].position_m, path.waypoints[-1].position_m)
    assert result["path_m"] == pytest.approx(2 * path.length_m + transit, abs=1e-5)


def test_a_first_path_through_the_object_is_bad_input() -> None:
    with pytest.raises(GeometryError, match="altitude_m"):
        execute(_config(survey={"waypoints": 6, "altitude_m": 2.0}))


def test_a_later_path_through_the_object_ends_the_mission_and_keeps_the_map() -> None:
    class Diver(FromTheSouth):
        def next_scan(self, belief: Belief, nav: Nav) -> Decision:
            path = path_over_centre(self.area, 0.0)
            if nav.scans:
                path = ScanPath(tuple(Pose(p.x_m, p.y_m, p.z_m - 4.0) for p in path.waypoints))
            return Decision(path=path)

    config = _config()
    run = execute(config, Diver(World(config)))
    assert run.stop_reason is StopReason.OBSTACLE
    assert len(run.history) == 1
    assert run.mapper.voxels.block_count > 0


def test_the_entropy_mission_stops_by_itself_and_lowers_the_entropy() -> None:
    run = execute(_config(survey={"waypoints": 20}))
    assert run.stop_reason in {StopReason.NOT_WORTH_IT, StopReason.NO_CLUSTER}
    entropies = [entry.total_entropy_bits for entry in run.history]
    assert len(entropies) > 1
    assert entropies == sorted(entropies, reverse=True)
    assert run.history[-1].metrics["solid"]["within_one_voxel"]["f1"] > 0.5
    assert len(run.decisions) == len(run.paths) + 1


def test_interrupting_keeps_what_was_scanned() -> None:
    count = 0

    def enough() -> bool:
        nonlocal count
        count += 1
        return count >= 9

    run = execute(_config(planner="uniform"), should_stop=enough)
    assert run.stop_reason is StopReason.INTERRUPTED
    assert [len(path.waypoints) for path in run.paths] == [6, 3]
    assert [entry.pings for entry in run.history] == [6, 9]


class Late(BayesMapper):
    """Does all its work at the end of a scan."""

    def __init__(self, settings: MappingSettings) -> None:
        super().__init__(settings)
        self.kept: list[tuple[Ping, Pose]] = []

    def integrate(self, ping: Ping, pose: Pose) -> None:
        self.kept.append((ping, pose))

    def finish_scan(self) -> None:
        for ping, pose in self.kept:
            super().integrate(ping, pose)
        self.kept.clear()


@pytest.mark.parametrize("stop_after", [6, 9])
def test_a_scan_that_is_cut_short_is_finished_too(stop_after: int) -> None:
    config = _config(planner="uniform")
    runs = []
    for mapper in (BayesMapper(config.mapping), Late(config.mapping)):
        asked = iter(range(1, 100))
        run = execute(config, mapper=mapper, should_stop=lambda it=asked: next(it) >= stop_after)  # type: ignore[misc]
        runs.append(run.history[-1])
    assert runs[0] == runs[1]
    assert runs[0].metrics["surface"]["exact"]["recall"] > 0.1


@pytest.mark.slow
def test_the_map_at_the_true_poses_is_finished_too() -> None:
    config = _config(
        planner="uniform",
        vehicle={"name": "bluerov2"},
        survey={"waypoints": 6, "baseline_scans": 1, "approach_m": 1.0, "overrun_m": 0.0},
    )
    ours, late = (
        execute(config, mapper=mapper).result().vehicle
        for mapper in (BayesMapper(config.mapping), Late(config.mapping))
    )
    assert ours is not None
    assert late is not None
    assert ours.metrics_at_true_poses == late.metrics_at_true_poses
