"""Planners side by side over seeds, as in Tables 2 and 3 of Park et al. 2025."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy import special

from insonify.config.settings import Table
from insonify.mission.loop import Step
from insonify.mission.result import ScanResult
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config, scenarios
from insonify.planning.factory import PLANNERS
from insonify.plugins import is_plugin, load_plugin

SCORES = ("precision", "recall", "f1", "f2", "f3")
NAVIGATION = ("truth", "dvl")
FIRST = "entropy"
"""Flies first; the planners with a fixed plan then get as many scans as it took."""


def compare(
    names: Sequence[str],
    seeds: int,
    layers: Iterable[Table] = (),
    planners: Sequence[str] = tuple(PLANNERS),
    *,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[ScanResult]:
    """Run planners on every scenario and seed.

    The entropy planner, if it is among them, flies first; the baselines then get as many scans, and
    so as many pings, as it took with that seed.

    Args:
        names: Scenarios.
        seeds: Seeds 0 to ``seeds - 1``.
        layers: Settings on top of each scenario.
        planners: Names of planners, or a user's own.
        watch: Called after every step of every run.
        should_stop: Asked during the runs; if true, the rows of the complete ones are returned.

    Raises:
        InsonifyError: A scenario or a setting is not usable.
    """
    layers = list(layers)
    order = sorted(dict.fromkeys(planners), key=lambda planner: planner != FIRST)
    settings = _by_planner(order, layers)
    _check_all(names, settings)
    rows: list[ScanResult] = []
    for name in names:
        for seed in range(seeds):
            scans: Table = {}
            for planner in order:
                chosen = {"planner": planner, "seed": seed}
                config = scenario_config(name, [*settings[planner], chosen, scans])
                run = execute(config, watch=watch, should_stop=should_stop)
                if should_stop():
                    return rows
                # a planner of a user's own may call itself anything; the row has its full name
                rows.append(run.result().model_copy(update={"planner": planner}))
                if planner == FIRST:
                    scans = {"survey": {"baseline_scans": len(run.paths)}}
    return rows


def _by_planner(planners: Sequence[str], layers: list[Table]) -> dict[str, list[Table]]:
    """The settings of each planner: options are for a user's own, if one is among them."""
    plain = layers
    if not PLANNERS.keys() >= set(planners):
        plain = [{k: v for k, v in layer.items() if k != "planner_options"} for layer in layers]
    return {planner: plain if planner in PLANNERS else layers for planner in planners}


def _check_all(names: Sequence[str], settings: dict[str, list[Table]]) -> None:
    """Bad input shows before the first run."""
    for name in names:
        for planner, layers in settings.items():
            config = scenario_config(name, [*layers, {"planner": planner}])
            for what, own in (("planner", config.planner), ("mapper", config.mapper)):
                if is_plugin(own):
                    load_plugin(own, what)


def summarise(rows: Sequence[ScanResult]) -> Table:
    """Mean and 95 % confidence interval of each score over the seeds, with the paper's figures.

    Returns:
        scenario -> planner -> {"scans", "pings", "path_m", "surface", "solid", "paper"}, where a
        figure of ours is {"mean", "ci95"} and ``ci95`` the half width of Student's interval
        (None for a single seed); "paper" is there for the paper's planners.
    """
    table: Table = {}
    for name in dict.fromkeys(row.scenario for row in rows):
        table[name] = {}
        for planner in dict.fromkeys(row.planner for row in rows if row.scenario == name):
            mine = [r for r in rows if r.scenario == name and r.planner == planner]
            table[name][planner] = {
                key: _interval([getattr(row, key) for row in mine])
                for key in ("scans", "pings", "path_m")
            } | {
                kind: {
                    match: {
                        score: _interval([row.metrics[kind][match][score] for row in mine])
                        for score in SCORES
                    }
                    for match in ("exact", "within_one_voxel")
                }
                for kind in ("surface", "solid")
            }
            paper = scenarios()[name]["paper"].get(planner)
            if paper is not None:
                table[name][planner]["paper"] = paper
    return table


def compare_navigation(
    names: Sequence[str],
    seeds: int,
    layers: Iterable[Table],
    *,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[ScanResult]:
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
    rows: list[ScanResult] = []
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


def summarise_navigation(rows: Sequence[ScanResult]) -> Table:
    """What navigation by estimate costs, over the seeds.

    Returns:
        scenario -> "truth", "dvl" and "cost" -> figures, each {"mean", "ci95"} as in `summarise`;
        the cost is the difference seed by seed.  The position error is the largest of a run.
    """
    table: Table = {}
    for name in dict.fromkeys(row.scenario for row in rows):
        by = {
            navigation: {
                row.seed: _flown(row)
                for row in rows
                if row.scenario == name and _navigation(row) == navigation
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


def _navigation(row: ScanResult) -> str:
    return row.vehicle.navigation if row.vehicle is not None else ""


def _flown(row: ScanResult) -> dict[str, float]:
    """The figures of a flown run that a comparison shows."""
    assert row.vehicle is not None
    scores = {
        f"{kind} f1, {match.replace('_', ' ')}": row.metrics[kind][match]["f1"]
        for kind in ("solid", "surface")
        for match in ("exact", "within_one_voxel")
    }
    return scores | {
        "largest position error, m": row.vehicle.pose_error["position_max_m"],
        "scans": row.scans,
        "path, m": row.path_m,
        "time, s": row.vehicle.time_s,
    }


def _interval(values: Sequence[float]) -> dict[str, float | None]:
    count = len(values)
    half = None
    if count > 1:
        t = float(special.stdtrit(count - 1, 0.975))
        half = t * float(np.std(values, ddof=1)) / math.sqrt(count)
    return {"mean": float(np.mean(values)), "ci95": half}
