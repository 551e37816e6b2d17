from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from insonify.errors import GeometryError, MemoryLimitError
from insonify.mapping.mapper import Belief
from insonify.mission.comparison import summarise
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.planning.decision import Decision
from insonify.types import Nav, StopReason

SMALL = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 8}}


def test_same_config_same_run_and_another_seed_another() -> None:
    rows, maps = [], []
    for seed in (1, 1, 2):
        run = execute(scenario_config("tetrapod", [SMALL, {"seed": seed}]))
        rows.append(run.result().to_json() | {"seconds": None})
        maps.append(run.mapper.voxels.log_odds.tobytes())
    assert rows[0] == rows[1] != rows[2]
    assert maps[0] == maps[1] != maps[2]


def test_a_voxel_size_beyond_memory_names_one_that_fits() -> None:
    with pytest.raises(MemoryLimitError, match="GB") as caught:
        execute(scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.001}}]))
    fits = float(re.findall(r"voxel_m=([0-9.]+)", str(caught.value))[0])
    assert 0.001 < fits < 0.1


def test_a_real_wreck_runs_to_a_score(real_mesh: Path) -> None:
    run = execute(scenario_config("wreck", [SMALL, {"object": {"mesh": str(real_mesh)}}]))
    scores = run.history[-1].metrics["surface"]["within_one_voxel"]
    assert scores["f1"] > 0.2
    assert run.truth.surface.sum() > 1000


def test_summary_is_mean_and_students_interval() -> None:
    run = execute(scenario_config("tetrapod", [SMALL, {"planner": "uniform"}])).result()
    rows = []
    for seed, f1 in enumerate((0.5, 0.6, 0.8)):
        scores = dict.fromkeys(("precision", "recall", "f1", "f2", "f3"), f1)
        metrics = {k: dict.fromkeys(v, scores) for k, v in run.metrics.items()}
        rows.append(run.model_copy(update={"seed": seed, "metrics": metrics}))
    figure = summarise(rows)["tetrapod"]["uniform"]["surface"]["exact"]["f2"]
    assert figure["mean"] == pytest.approx(19 / 30)
    # t(0.975, 2 degrees of freedom) = 4.3027
    assert figure["ci95"] == pytest.approx(
        4.3027 * np.std([0.5, 0.6, 0.8], ddof=1) / 3**0.5, rel=1e-4
    )


def test_a_snapshot_holds_the_entropy_map_and_where_nothing_was_seen() -> None:
    run = execute(scenario_config("wreck", [SMALL]))
    bits = run.decisions[1].entropy_bits
    assert bits is not None
    seen = np.isfinite(bits)
    assert 0 < seen.sum() < seen.size
    assert 0.0 <= bits[seen].min() < 1.0 < bits[seen].max()


def test_the_noise_follows_the_seed() -> None:
    """Not only the seabed's relief, which is flat here."""
    flat = {"seabed": {"relief_m": 0.0}}
    maps = [
        execute(
            scenario_config("tetrapod", [SMALL, flat, {"seed": s, "planner": "uniform"}])
        ).mapper.voxels.log_odds.tobytes()
        for s in (1, 2)
    ]
    assert maps[0] != maps[1]


def test_a_planner_that_stops_at_once_is_scored_on_an_empty_map() -> None:
    class Idle:
        name = "idle"

        def next_scan(self, belief: Belief, nav: Nav) -> Decision:
            return Decision(stop=StopReason.PLAN_FLOWN)

    result = execute(scenario_config("tetrapod", [SMALL]), Idle()).result().to_json()
    assert (result["scans"], result["metrics"]["solid"]["exact"]["f1"]) == (0, 0.0)


def test_a_fixed_plan_that_hits_the_object_is_refused_before_it_is_flown() -> None:
    low = {"survey": {"altitude_m": 3.0}, "planner": "lawnmower"}
    with pytest.raises(GeometryError, match="altitude_m"):
        execute(scenario_config("tetrapod", [SMALL, low]))
