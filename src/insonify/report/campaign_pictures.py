"""Pictures of a campaign, as PNG bytes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insonify.mission.statistics import height_at, interval
from insonify.mission.tables import AREAS, short
from insonify.names import figure_text
from insonify.report.fans import INK, png
from insonify.types import Float64

_POINTS = 200
_LABELS = {"path_m": "path, m", "pings": "pings", "time_s": "time, s"}


def draw_curves(curves: Any, score: str) -> bytes:
    """A score against path, pings and a vehicle's time: means over the seeds with 95 % bands.

    Args:
        curves: Of `Campaign`, of one setting.
        score: A column of theirs.
    """
    spent = [along for along in AREAS.values() if curves[along].notna().all()]
    figure = Figure(figsize=(4.9 * len(spent), 3.9), layout="constrained")
    row = np.atleast_1d(figure.subplots(1, len(spent), sharey=True))
    for axes, along in zip(row, spent, strict=True):
        curves_onto(axes, curves, score, along)
    row[0].set_ylabel(score.replace("_", " "), fontsize=9)
    row[0].legend(fontsize=7, loc="lower right")
    return png(figure)


def curves_onto(axes: Axes, curves: Any, score: str, along: str) -> None:
    """Draw the curves of one setting into axes."""
    end = float(curves[along].max())
    at = np.linspace(0.0, end, _POINTS)
    for number, (names, group) in enumerate(curves.groupby(["mapper", "planner"], sort=False)):
        runs = list(_runs(group, score, along))
        means, halves = zip(
            *(interval(column) for column in np.array([height_at(x, y, at) for x, y in runs]).T),
            strict=True,
        )
        colour = f"C{number % 10}"
        axes.plot(at, means, color=colour, lw=1.4, label=figure_text(", ".join(map(short, names))))
        if None not in halves:
            mean, half = np.array(means), np.array(halves, float)
            axes.fill_between(at, mean - half, mean + half, color=colour, alpha=0.18, lw=0)
        ends = np.array([[x[-1], y[-1]] for x, y in runs]).mean(axis=0)
        axes.plot(*ends, "o", color=colour, ms=5, mec=INK, mew=0.6)
    axes.set(xlabel=_LABELS[along], xlim=(0.0, end or 1.0), ylim=(0.0, 1.0))
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def _runs(group: Any, score: str, along: str) -> Iterator[tuple[Float64, Float64]]:
    """The curve of each run: where its moments are, and what was reached."""
    for _, moments in group.groupby("run", sort=False):
        yield moments[along].to_numpy(float), moments[score].to_numpy(float)
