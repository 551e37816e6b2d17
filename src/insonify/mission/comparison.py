"""Planners side by side over seeds, as in Tables 2 and 3 of Park et al. 2025."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from insonify.config.layers import overlaid
from insonify.config.settings import Table
from insonify.mission.campaign import CampaignSettings, chains
from insonify.mission.crew import Failure, Here, Place, Processes, fly_all
from insonify.mission.loop import Step
from insonify.mission.result import ScanResult
from insonify.mission.run import Run
from insonify.mission.setup import scenario_config, scenarios
from insonify.mission.statistics import interval
from insonify.planning.factory import COMPARED, PLANNERS

SCORES = ("precision", "recall", "f1", "f2", "f3")
NAVIGATION = ("truth", "dvl")


def compare(
    names: Sequence[str],
    seeds: int,
    layers: Iterable[Table] = (),
    planners: Sequence[str] = COMPARED,
    *,
    workers: int = 1,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[ScanResult]:
    """Run planners on every scenario and seed: a small campaign.

    The entropy planner, if it is among them, flies first; the baselines then get as many scans, and
    so as many pings, as it took with that seed.

    Args:
        names: Scenarios.
        seeds: Seeds 0 to ``seeds - 1``.
        layers: Settings on top of each scenario.
        planners: Names of planners, or a user's own.
        workers: Processes; more than one want the caller guarded by ``__name__ == "__main__"``.
        watch: Called after every step of every run, if this process flies them.
        should_stop: Asked during the runs; if true, the rows of the complete ones are returned.

    Raises:
        InsonifyError: A scenario or a setting is not usable, or a run failed.
    """
    settings = _settings(names, layers, "planner", "seed")
    options = {"planner_options": settings.pop("planner_options", {})}
    own = [planner for planner in planners if planner not in PLANNERS]
    campaign = CampaignSettings(
        scenarios=tuple(names),
        seeds=tuple(range(seeds)),
        planners=tuple(dict.fromkeys(planners)),
        set=settings if own else settings | options,
        set_for=dict.fromkeys(own, options),
    )
    return _rows(campaign, workers, watch, should_stop)


def compare_navigation(
    names: Sequence[str],
    seeds: int,
    layers: Iterable[Table],
    *,
    workers: int = 1,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[ScanResult]:
    """Fly every scenario and seed twice, by the truth and by the vehicle's own estimate.

    Args:
        names: Scenarios.
        seeds: Seeds 0 to ``seeds - 1``.
        layers: Settings on top of each scenario; they name the vehicle.
        workers: As in `compare`; so is ``watch``.
        watch: Called after every step of every run.
        should_stop: Asked during the runs; if true, the rows of the complete ones are returned.

    Raises:
        InsonifyError: A scenario or a setting is not usable, or a run failed.
    """
    settings = _settings(names, layers, "seed")
    if isinstance(settings.get("vehicle"), dict):
        settings["vehicle"] = {k: v for k, v in settings["vehicle"].items() if k != "navigation"}
    campaign = CampaignSettings(
        scenarios=tuple(names), seeds=tuple(range(seeds)), navigation=NAVIGATION, set=settings
    )
    return _rows(campaign, workers, watch, should_stop)


def _settings(names: Sequence[str], layers: Iterable[Table], *chosen: str) -> Table:
    """Layers as the settings of a campaign, without what it chooses itself."""
    settings = overlaid(layers)
    for name in names:
        if settings.get("scenario", name) != name:
            scenario_config(name, [settings])  # says so
    return {key: value for key, value in settings.items() if key not in ("scenario", *chosen)}


def _rows(
    campaign: CampaignSettings,
    workers: int,
    watch: Callable[[Run, Step], None],
    should_stop: Callable[[], bool],
) -> list[ScanResult]:
    """The results of all runs, by scenario, seed and planner; the first failure ends it."""
    plan = chains(campaign)
    found: dict[Place, ScanResult] = {}
    with Here(watch, should_stop) if workers == 1 else Processes(workers) as crew:
        for landed in fly_all(plan, crew, should_stop=should_stop):
            if isinstance(landed.outcome, Failure):
                raise landed.outcome.error()
            found[landed.place] = landed.outcome
    return [found[place] for place in sorted(found)]


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
            paper = scenarios()[name].get("paper", {}).get(planner)
            if paper is not None:
                table[name][planner]["paper"] = paper
    return table


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
    mean, half = interval(values)
    return {"mean": mean, "ci95": half}
