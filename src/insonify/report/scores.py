"""How good the map was at each moment, as PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insonify.mission.result import ScanResult, ScanRow
from insonify.report.colours import BLUE, INK, ORANGE, SKY, SOFT
from insonify.report.fans import png

ALONG = {"path_m": "path, m", "pings": "pings", "time_s": "time, s"}
_SEEN = 5e-4
"""A loss of F1 that its three digits show."""


def losses(history: Sequence[ScanRow]) -> list[tuple[ScanRow, ScanRow]]:
    """Scans after which F1 (solid, exact) was lower than before: the moments before and after."""
    pairs = pairwise(history)
    return [(before, after) for before, after in pairs if _f1(after) < _f1(before) - _SEEN]


def draw_scores(result: ScanResult, along: str) -> bytes:
    """F1, precision and recall after each scan, and which scans made the map worse.

    Args:
        result: With its history.
        along: What they are drawn over, of `ALONG`.
    """
    figure, axes = _chart(along)
    at = [0.0, *(getattr(row, along) for row in result.history)]
    curves: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("solid", "precision", {"color": SOFT, "ls": "--", "lw": 1.2}),
        ("solid", "recall", {"color": SOFT, "ls": ":", "lw": 1.6}),
        ("surface", "f1", {"color": SKY, "ls": "-", "lw": 1.6, "marker": "s", "ms": 4}),
        ("solid", "f1", {"color": BLUE, "ls": "-", "lw": 2.4, "marker": "o", "ms": 6}),
    )
    for kind, name, style in curves:
        values = [row.metrics[kind]["exact"][name] for row in result.history]
        label = {"f1": f"F1, {kind}"}.get(name, f"{name}, {kind}")
        axes.plot(at[1:], values, label=label, **style)
        if name == "f1":
            axes.plot(at[:2], [0.0, values[0]], ":", color=style["color"], lw=1.0)
    for before, after in losses(result.history):
        _mark(axes, getattr(after, along), before, after, at[-1])
    axes.set(ylim=(0.0, 1.0), xlim=(0.0, 1.03 * at[-1] or 1.0), ylabel="exact score")
    axes.legend(fontsize=9, loc="lower right", framealpha=0.9)
    return png(figure)


def draw_entropy_left(result: ScanResult) -> bytes:
    """The entropy of the designated area after each scan, over the path."""
    figure, axes = _chart("path_m")
    at = [row.path_m for row in result.history]
    kbit = [row.total_entropy_bits / 1000.0 for row in result.history]
    axes.plot(at, kbit, "-o", color=INK, lw=2.0, ms=6)
    axes.set(
        xlim=(0.0, 1.03 * at[-1] or 1.0), ylim=(0.0, 1.08 * max(kbit) or 1.0),
        ylabel="entropy left, kbit",
    )  # fmt: skip
    return png(figure)


def _chart(along: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(5.0, 3.3), layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlabel(ALONG[along])
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _mark(axes: Axes, at: float, before: ScanRow, after: ScanRow, end: float) -> None:
    axes.plot(at, _f1(after), "v", color=ORANGE, ms=11, mec="w", mew=1.0, zorder=5)
    axes.annotate(
        f"scan {after.scan} made it worse\n{_f1(before):.3f} to {_f1(after):.3f}",
        (at, _f1(after)), (0.0, -16.0), textcoords="offset points", fontsize=9, color=ORANGE,
        ha="right" if at > 0.6 * end else "left" if at < 0.3 * end else "center", va="top",
        bbox={"fc": "w", "ec": "none", "alpha": 0.8, "pad": 1.0},
    )  # fmt: skip


def _f1(row: ScanRow) -> float:
    return row.metrics["solid"]["exact"]["f1"]
