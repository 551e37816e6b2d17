from __future__ import annotations

from itertools import product
from typing import Any

import pandas as pd
import pytest
from scipy import stats

from insonify.mission.campaign import FACTORS
from insonify.mission.result import FlightResult, ScanResult, ScanRow
from insonify.mission.setup import scenario_config
from insonify.mission.statistics import holm
from insonify.mission.tables import (
    Campaign,
    areas,
    curve_rows,
    paired,
    run_row,
    scores,
    summarise_campaign,
)
from insonify.types import StopReason

GAIN = {"a": 0.0, "b": 0.1}
SKILL = {"entropy": 0.3, "uniform": 0.2, "lawnmower": 0.1}


def _campaign(seeds: int = 3) -> Campaign:
    """Mapper b gains 0.1, planners their skill, whatever the other; and chance by seed."""
    curves, runs = [], []
    for mapper, planner, seed in product(GAIN, SKILL, range(seeds)):
        names = dict(zip(FACTORS, ("wreck", "s", "m", "none", mapper, planner, seed), strict=True))
        score = GAIN[mapper] + SKILL[planner] + 0.01 * seed * (1 + (planner == "entropy"))
        run = {"run": f"{mapper}-{planner}-{seed}", **names}
        curves += [
            run | {"scan": scan, "pings": 10 * scan, "path_m": 20.0 * scan, "time_s": None}
            | {"solid_exact_f1": score * scan / 2}
            for scan in (1, 2)
        ]  # fmt: skip
        runs.append(run | {"scans": 2, "pings": 20, "path_m": 40.0, "solid_exact_f1": score})
    return Campaign("t", pd.DataFrame(runs), pd.DataFrame(curves), pd.DataFrame(), ())


def test_a_mappers_gain_is_not_credited_to_a_planner() -> None:
    rows = paired(_campaign().runs)
    by: dict[tuple[Any, ...], Any] = {(r["names"], r["same"].get("mapper")): r for r in rows}
    assert len(rows) == 2 * 3 + 3
    for mapper in GAIN:
        assert by[("uniform", "lawnmower"), mapper]["mean"] == pytest.approx(0.1)
        assert by[("entropy", "uniform"), mapper]["mean"] == pytest.approx(0.11)
    crossed = [row for row in rows if row["factor"] == "mapper"]
    assert [row["mean"] for row in crossed] == pytest.approx([-0.1] * 3)
    assert {row["same"]["planner"] for row in crossed} == set(SKILL)


def test_tests_are_paired_by_seed_and_corrected_together() -> None:
    runs = _campaign(4).runs
    runs.loc[runs["run"] == "a-uniform-2", "solid_exact_f1"] += 0.05
    rows = paired(runs)
    row = next(r for r in rows if r["names"] == ("entropy", "uniform"))
    values = [
        runs[(runs.mapper == "a") & (runs.planner == planner)]["solid_exact_f1"]
        for planner in row["names"]
    ]
    expected = stats.ttest_rel(*values)
    assert row["p"] == pytest.approx(expected.pvalue)
    low, high = expected.confidence_interval(0.95)
    assert row["ci95"] == pytest.approx((high - low) / 2)
    assert [r["p_holm"] for r in rows] == holm([r["p"] for r in rows])


def test_a_seed_that_one_lacks_is_left_out_and_a_single_one_is_not_tested() -> None:
    runs = _campaign(2).runs
    runs = runs[runs["run"] != "a-entropy-1"]
    row = next(r for r in paired(runs) if r["names"] == ("entropy", "uniform"))
    assert (row["seeds"], row["p"], row["p_holm"], row["ci95"]) == (1, None, None, None)


def test_areas_reach_to_the_end_of_the_longest_run_of_a_setting() -> None:
    curves = _campaign(1).curves
    longer = curves["run"] == "b-uniform-0"
    curves.loc[longer, "path_m"] *= 2
    found = areas(curves)
    # 0.2 at 40 m, held to 80 m; the longer one reaches 0.3 at 80 m
    assert found["a-uniform-0"] == pytest.approx((0.1 * 40 + 0.2 * 40) / 80)
    assert found["b-uniform-0"] == pytest.approx(0.15)
    assert areas(curves, along="pings")["a-uniform-0"] == pytest.approx(0.1)


def test_summary_has_a_row_for_each_combination() -> None:
    rows = summarise_campaign(_campaign())
    assert [(row["mapper"], row["planner"]) for row in rows] == list(product(GAIN, SKILL))
    assert rows[0]["seeds"] == 3
    assert rows[0]["solid_exact_f1"]["mean"] == pytest.approx(0.32)
    assert rows[0]["path_m"] == {"mean": 40.0, "ci95": 0.0}


def test_rows_take_whatever_scores_a_run_has() -> None:
    metrics = {"solid": {"exact": {"f1": 0.5}}, "oracle": {"exact": {"recall": 0.7}}}
    moments = tuple(
        ScanRow(scan=k, pings=k, path_m=k, time_s=2.0 * k, total_entropy_bits=1, metrics=metrics)
        for k in (1, 2)
    )
    config = scenario_config("tetrapod", [{"vehicle": {"name": "bluerov2"}, "seed": 5}])
    flight = FlightResult(
        name="bluerov2", navigation="dvl", time_s=4.5, pose_error={"position_max_m": 0.1},
        metrics_at_true_poses=metrics,
    )  # fmt: skip
    result = ScanResult(
        scenario="tetrapod", planner="entropy", mapper="bayes", seed=5, scans=2, pings=2, path_m=2,
        stop_reason=StopReason.PLAN_FLOWN, metrics=metrics, history=moments, seconds={"sonar": 1},
        vehicle=flight,
    )  # fmt: skip
    first, last = curve_rows("k", config, result)
    assert (first["scan"], last["time_s"], last["oracle_exact_recall"]) == (1, 4.0, 0.7)
    assert first["navigation"] == "dvl" and first["seed"] == 5
    row = run_row("k", config, result)
    assert (row["scans"], row["time_s"], row["stop_reason"]) == (2, 4.5, "plan_flown")
    assert row["true_poses_oracle_exact_recall"] == 0.7 and row["pose_error_position_max_m"] == 0.1
    assert scores(pd.DataFrame([row])) == ["solid_exact_f1", "oracle_exact_recall"]
