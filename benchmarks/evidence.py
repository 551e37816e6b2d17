"""The tables of docs/evidence.md from the campaigns that were flown for them.

``python -m benchmarks.evidence insonify-runs/evidence insonify-runs/evidence-entropy`` prints
means over the seeds of each object's runs, and compares `rosette`, or ``--best``, with every other
planner, seed by seed with the same mapper, at equal pings and at equal path: both curves are read
where the shorter of the two runs ends.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from insonify.mission.statistics import height_at, interval
from insonify.mission.tables import HEADLINE, areas
from insonify.report.fans import png
from insonify.results.campaign import load_campaign

SCORES = (HEADLINE, "surface_exact_f1", "surface_within_one_voxel_f1", "ghosts")
SHARE = 0.95
_PAIR = ["scenario", "mapper", "seed"]


def main() -> None:
    """Load, and print one table after another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="of campaigns")
    parser.add_argument(
        "--best", default="rosette", help="the planner that others are held against"
    )
    parser.add_argument("--picture", type=Path, help="PNG of the mean curves")
    given = parser.parse_args()
    campaigns = [load_campaign(folder) for folder in given.folders]
    runs = pd.concat([campaign.runs for campaign in campaigns], ignore_index=True)
    curves = pd.concat([campaign.curves for campaign in campaigns], ignore_index=True)
    if given.picture is not None:
        given.picture.write_bytes(_picture(curves, given.best))
    for _, group in runs.groupby("navigation", sort=False):
        _means(group)
    for mapper, own in curves.groupby("mapper", sort=False):
        print(f"\n{given.best} less others, `{mapper}`: mean over objects and seeds, worst, won")
        print("\n| | equal pings | equal path | path to 95 %, of theirs | area along path |")
        print("|---|---|---|---|---|")
        for planner in own["planner"].unique():
            if planner != given.best:
                pairs = list(_pairs(own, given.best, planner))
                print(f"| {planner} | " + " | ".join(_against(own, pairs)) + " |")
        _areas(own)


def _picture(curves: Any, best: str) -> bytes:
    """F1 against the path flown, a panel for each mapper: the mean over objects and seeds."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    panels = figure.subplots(1, curves["mapper"].nunique(), sharey=True, squeeze=False)[0]
    path_m = np.linspace(0.0, 150.0, 301)
    for axes, (mapper, own) in zip(panels, curves.groupby("mapper", sort=False), strict=True):
        for planner, flown in own.groupby("planner", sort=False):
            heights = [
                height_at(run["path_m"].to_numpy(float), run[HEADLINE].to_numpy(float), path_m)
                for _, run in flown.groupby(["scenario", "seed"], sort=False)
            ]
            width = 2.5 if planner == best else 1.3
            axes.plot(path_m, np.mean(heights, axis=0), lw=width, label=planner)
        axes.set(title=mapper, xlabel="path flown, m", ylim=(0.0, 0.9))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("F1, solid, mean over objects and seeds")
    panels[-1].legend(fontsize=8, loc="lower right")
    return png(figure)


def _means(runs: Any) -> None:
    """Every score, by object, of all mappers and planners."""
    for score in SCORES:
        print(f"\n{score.replace('_', ' ')}, navigation {runs['navigation'].iloc[0]}\n")
        for mapper, own in runs.groupby("mapper", sort=False):
            table = own.pivot_table(score, "scenario", "planner", ["mean", "count"], sort=False)
            planners = list(table["mean"].columns)
            print(f"| `{mapper}` | " + " | ".join(planners) + " | seeds |")
            print("|---|" + "---|" * (len(planners) + 1))
            for scenario, row in table.iterrows():
                seeds = int(row["count"].max())
                print(_row(str(scenario), [*row["mean"], seeds]))
            print(_row("mean", [*table["mean"].mean(), ""]))
            print()


def _row(name: str, values: Sequence[Any]) -> str:
    told = (f"{value:.3f}" if isinstance(value, float) else str(value) for value in values)
    return f"| {name} | " + " | ".join(told) + " |"


def _areas(curves: Any) -> None:
    """How much was known how early, by scenario: the mean height of curves along the path."""
    mean = areas(curves)
    runs = curves.drop_duplicates("run").assign(area=lambda run: run["run"].map(mean))
    table = runs.pivot_table("area", "scenario", "planner", sort=False)
    print("\n| mean height along path | " + " | ".join(table.columns) + " |")
    print("|---|" + "---|" * len(table.columns))
    for scenario, row in table.iterrows():
        print(_row(str(scenario), list(row)))


Pairs = list[tuple[str, Any, Any]]


def _against(curves: Any, pairs: Pairs) -> Iterator[str]:
    """The best planner and another with one mapper, in four ways."""
    for along in ("pings", "path_m"):
        yield _differences(pairs, partial(_at_equal, along))
    yield _ratios(pairs)
    mean = areas(curves)
    yield _differences(pairs, lambda one, other: mean[_run(one)] - mean[_run(other)])


def _pairs(curves: Any, best: str, planner: str) -> Iterator[tuple[str, Any, Any]]:
    """Scenario, and the moments of both planners' runs with the same seed."""
    for (scenario, _, _), both in curves.groupby(_PAIR, sort=False):
        one, other = both[both["planner"] == best], both[both["planner"] == planner]
        if len(one) and len(other):
            yield str(scenario), one, other


def _differences(pairs: Pairs, compare: Callable[[Any, Any], float]) -> str:
    found: dict[str, list[float]] = {}
    for scenario, one, other in pairs:
        found.setdefault(scenario, []).append(compare(one, other))
    if not found:
        return ""
    every = np.concatenate(list(found.values()))
    mean, half = interval(every)
    worst = min(found, key=lambda name: float(np.mean(found[name])))
    spread = "" if half is None else f" \u00b1 {half:.3f}"
    return (
        f"{mean:+.3f}{spread}, {worst} {np.mean(found[worst]):+.3f}, "
        f"{np.count_nonzero(every > 0)} of {len(every)}"
    )


def _at_equal(along: str, one: Any, other: Any) -> float:
    """Difference of two runs' scores where the shorter ends."""
    end = np.array([min(one[along].max(), other[along].max())])
    heights = [
        height_at(run[along].to_numpy(float), run[HEADLINE].to_numpy(float), end)[0]
        for run in (one, other)
    ]
    return float(heights[0] - heights[1])


def _ratios(pairs: Pairs) -> str:
    """How much of the other's path it takes to 95 % of the better end, and how often half of it.

    Where the other never gets there, any way is shorter.
    """
    ratios = []
    for _, one, other in pairs:
        goal = SHARE * max(one[HEADLINE].iloc[-1], other[HEADLINE].iloc[-1])
        ours, theirs = _path_to(one, goal), _path_to(other, goal)
        ratios.append(ours / theirs if np.isfinite(ours) else np.inf)
    half = np.count_nonzero(np.array(ratios) <= 0.5)
    reached = [ratio for ratio in ratios if 0.0 < ratio < np.inf]
    median = f"{np.median(reached):.2f} where both do" if reached else "-"
    return f"{median}; at most half in {half} of {len(ratios)}"


def _path_to(run: Any, goal: float) -> float:
    """Metres flown until a run's score reaches a goal; infinite if it never does."""
    x = np.concatenate([[0.0], run["path_m"].to_numpy(float)])
    y = np.maximum.accumulate(np.concatenate([[0.0], run[HEADLINE].to_numpy(float)]))
    if y[-1] < goal:
        return float("inf")
    k = int(np.argmax(y >= goal))
    return float(np.interp(goal, y[k - 1 : k + 1], x[k - 1 : k + 1]))


def _run(moments: Any) -> str:
    return str(moments["run"].iloc[0])


if __name__ == "__main__":
    main()
