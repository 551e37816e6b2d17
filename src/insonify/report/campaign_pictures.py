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
from insonify.report.colours import INK, series
from insonify.report.fans import png
from insonify.report.scores import ALONG
from insonify.types import Float64

_POINTS = 200


def draw_curves(curves: Any, score: str, label: str) -> list[tuple[str, bytes]]:
    """A score against path, pings and a vehicle's time: means over the seeds with 95 % bands.

    Args:
        curves: Of `Campaign`, of one setting.
        score: A column of theirs.
        label: What it is called.

    Returns:
        A picture for each, named after what it is drawn over.
    """
    drawn = []
    for along in AREAS.values():
        if curves[along].notna().all():
            figure = Figure(figsize=(5.2, 4.0), layout="constrained")
            axes = figure.add_subplot()
            curves_onto(axes, curves, score, along)
            axes.set_ylabel(label)
            axes.legend(fontsize=8.5, loc="lower right", framealpha=0.85)
            drawn.append((ALONG[along].partition(",")[0], png(figure)))
    return drawn


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
        colour, style = series(number)
        axes.plot(
            at, means, style, color=colour, lw=1.9, label=figure_text(", ".join(map(short, names)))
        )
        if None not in halves:
            mean, half = np.array(means), np.array(halves, float)
            axes.fill_between(at, mean - half, mean + half, color=colour, alpha=0.18, lw=0)
        ends = np.array([[x[-1], y[-1]] for x, y in runs]).mean(axis=0)
        axes.plot(*ends, "o", color=colour, ms=5, mec=INK, mew=0.6)
    axes.set(xlabel=ALONG[along], xlim=(0.0, end or 1.0), ylim=(0.0, 1.0))
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def _runs(group: Any, score: str, along: str) -> Iterator[tuple[Float64, Float64]]:
    """The curve of each run: where its moments are, and what was reached."""
    for _, moments in group.groupby("run", sort=False):
        yield moments[along].to_numpy(float), moments[score].to_numpy(float)
