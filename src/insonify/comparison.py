"""Planners side by side over seeds, as in Tables 2 and 3 of Park et al. 2025."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy import special

from insonify.mission import Step
from insonify.runs import Run, execute
from insonify.scenarios import PLANNERS, Table, scenario_config, scenarios

SCORES = ("precision", "recall", "f1", "f2", "f3")
NAVIGATION = ("truth", "dvl")
Row = dict[str, Any]


def compare(
    names: Sequence[str],
    seeds: int,
    layers: Iterable[Table] = (),
    *,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[Row]:
    """Run every planner on every scenario and seed.

    The entropy planner flies first; the baselines then get as many scans, and so as many pings,
    as it took with that seed.

    Args:
        names: Scenarios.
        seeds: Seeds 0 to ``seeds - 1``.
        layers: Settings on top of each scenario.
        watch: Called after every step of every run.
        should_stop: Asked during the runs; if true, the rows of the complete ones are returned.

    Raises:
        InsonifyError: A scenario or a setting is not usable.
    """
    layers = list(layers)
    for name in names:
        scenario_config(name, layers)  # bad input shows before the first run
    rows: list[Row] = []
    for name in names:
        for seed in range(seeds):
            scans: Table = {}
            for planner in PLANNERS:
                chosen = {"planner": planner, "seed": seed}
                config = scenario_config(name, [*layers, chosen, scans])
                run = execute(config, watch=watch, should_stop=should_stop)
                if should_stop():
                    return rows
                rows.append(run.result())
                scans = scans or {"survey": {"baseline_scans": len(run.paths)}}
    return rows


def summarise(rows: Sequence[Row]) -> Row:
    """Mean and 95 % confidence interval of each score over the seeds, with the paper's figures.

    Returns:
        scenario -> planner -> {"scans", "pings", "path_m", "surface", "solid", "paper"}, where a
        figure of ours is {"mean", "ci95"} and ``ci95`` the half width of Student's interval
        (None for a single seed).
    """
    table: Row = {}
    for name in dict.fromkeys(row["scenario"] for row in rows):
        table[name] = {}
        for planner in PLANNERS:
            mine = [r for r in rows if r["scenario"] == name and r["planner"] == planner]
            if not mine:
                continue
            table[name][planner] = {
                key: _interval([row[key] for row in mine]) for key in ("scans", "pings", "path_m")
            } | {
                kind: {
                    match: {
                        score: _interval([row["metrics"][kind][match][score] for row in mine])
                        for score in SCORES
                    }
                    for match in ("exact", "within_one_voxel")
                }
                for kind in ("surface", "solid")
            }
            table[name][planner]["paper"] = scenarios()[name]["paper"][planner]
    return table


def compare_navigation(
    names: Sequence[str],
    seeds: int,
    layers: Iterable[Table],
    *,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[Row]:
    """Fly every scenario and seed twice, by the truth and by the vehicle's own estimate.

    Args:
        names: Scenarios.
        seeds: Seeds 0 to ``seeds - 1``.
        layers: Settings on top of each scenario; they name the vehicle.
        watch: Called after every step of every run.
        should_stop: Asked during the runs; if true, the rows of the complete ones are returned.

    Raises:
        InsonifyError: A scenario or a setting is not usable.
    """
    layers = list(layers)
    for name in names:
        scenario_config(name, layers)
    rows: list[Row] = []
    for name in names:
        for seed in range(seeds):
            for navigation in NAVIGATION:
                chosen = {"seed": seed, "vehicle": {"navigation": navigation}}
                config = scenario_config(name, [*layers, chosen])
                run = execute(config, watch=watch, should_stop=should_stop)
                if should_stop():
                    return rows
                rows.append(run.result())
    return rows


def summarise_navigation(rows: Sequence[Row]) -> Row:
    """What navigation by estimate costs, over the seeds.

    Returns:
        scenario -> "truth", "dvl" and "cost" -> figures, each {"mean", "ci95"} as in `summarise`;
        the cost is the difference seed by seed.  The position error is the largest of a run.
    """
    table: Row = {}
    for name in dict.fromkeys(row["scenario"] for row in rows):
        by = {
            navigation: {
                row["seed"]: _flown(row)
                for row in rows
                if row["scenario"] == name and row["vehicle"]["navigation"] == navigation
            }
            for navigation in NAVIGATION
        }
        both = sorted(set(by["truth"]) & set(by["dvl"]))
        if not both:
            continue
        keys = list(by["truth"][both[0]])
        table[name] = {
            navigation: {key: _interval([by[navigation][s][key] for s in both]) for key in keys}
            for navigation in NAVIGATION
        }
        table[name]["cost"] = {
            key: _interval([by["dvl"][s][key] - by["truth"][s][key] for s in both]) for key in keys
        }
    return table


def _flown(row: Row) -> dict[str, float]:
    """The figures of a flown run that a comparison shows."""
    scores = {
        f"{kind} f1, {match.replace('_', ' ')}": row["metrics"][kind][match]["f1"]
        for kind in ("solid", "surface")
        for match in ("exact", "within_one_voxel")
    }
    return scores | {
        "largest position error, m": row["vehicle"]["pose_error"]["position_max_m"],
        "scans": row["scans"],
        "path, m": row["path_m"],
        "time, s": row["vehicle"]["time_s"],
    }


def _interval(values: Sequence[float]) -> dict[str, float | None]:
    count = len(values)
    half = None
    if count > 1:
        t = float(special.stdtrit(count - 1, 0.975))
        half = t * float(np.std(values, ddof=1)) / math.sqrt(count)
    return {"mean": float(np.mean(values)), "ci95": half}
