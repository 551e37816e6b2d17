"""What draws the records that show themselves (`insonify.display.Artist`)."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import singledispatch
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from insonify.errors import GeometryError, ResultError
from insonify.mapping.voxels import BYTES_PER_VOXEL, OBSERVED, VOXELS_PER_BLOCK, VoxelMap
from insonify.mission.account import Account
from insonify.mission.run import Run
from insonify.mission.tables import HEADLINE, SETTING, Campaign, short, summarise_campaign
from insonify.names import figure_text, plain
from insonify.report.campaign_pictures import curves_onto, draw_curves
from insonify.report.colours import scan_colour
from insonify.report.fans import INK, PALE, WATER, Scale, fan_onto, png
from insonify.report.pictures import draw_ground
from insonify.types import Array, Float64, Ping, PosedPing

_SIDES = {"above": (0, 1, 2, 1), "south": (0, 2, 1, -1), "east": (1, 2, 0, 1)}
"""From where a map is seen: axes across, up, towards the eye, and which way that one points."""
_NAMES = ("x (east), m", "y (north), m", "z (up), m")
_MOST_CELLS = 2000
"""Cells along an edge of a map's picture; of a larger map several voxels share one."""
_EPOCH_S, _LAST_S = 1e8, 1e11
"""Times between these are of a clock that counts from 1970."""
_MOST_SETTINGS = 4
"""Of a campaign, that are drawn unasked."""

Facts = Mapping[str, object]


def plot(record: Any, axes: Axes | None, **options: Any) -> Axes:
    """Draw a record into axes, or into those of a new figure.

    Raises:
        InsonifyError: An option names what is not there.
    """
    if axes is None:
        # notebooks and plt.show() show what pyplot knows of, and no other figures
        from matplotlib import pyplot  # noqa: TID251

        figure = pyplot.figure(figsize=_size_in(record), layout="constrained")
        if isinstance(record, Ping | PosedPing):
            figure.set_facecolor(WATER)
        axes = figure.add_subplot()
    _onto(record, axes, **options)
    return axes


def picture(record: Any) -> bytes:
    """A record as PNG."""
    figure = Figure(figsize=_size_in(record), layout="constrained")
    if isinstance(record, Ping | PosedPing):
        figure.set_facecolor(WATER)
    _onto(record, figure.add_subplot())
    return png(figure)


def page(record: Any) -> str:
    """A record as a piece of HTML: its figures, and pictures."""
    title, facts, table, pictures = _told(record)
    rows = "".join(f"<tr>{_th(name)}{_td(value)}</tr>" for name, value in facts.items())
    images = "".join(
        f'<img style="max-width:100%" alt="{escape(title)}" '
        f'src="data:image/png;base64,{b64encode(data).decode()}">'
        for data in pictures
    )
    return f"<div><b>{_cell(title)}</b><table>{rows}</table>{_rows(table)}{images}</div>"


@singledispatch
def _onto(record: Any, axes: Axes, **options: Any) -> None:
    """Draw a record of a kind that shows itself into axes."""
    raise TypeError(f"{type(record).__name__} is not drawn")


@_onto.register
def _ping_onto(record: Ping, axes: Axes, *, power: float = 0.6) -> None:
    figure = axes.get_figure(root=True)
    assert figure is not None
    scale = Scale(power=power)
    ink = PALE if np.mean(to_rgb(figure.get_facecolor())) < 0.5 else INK
    scale.bar(figure, fan_onto(axes, record, scale, ink), axes, ink)
    axes.set_title(_when(record.time_s), fontsize=9, color=ink)


@_onto.register
def _posed_onto(record: PosedPing, axes: Axes, *, power: float = 0.6) -> None:
    _ping_onto(record.ping, axes, power=power)
    if record.pose is not None:
        x, y, z = record.pose.position_m
        heading = round(math.degrees(record.pose.yaw_rad))
        axes.title.set_text(f"{axes.get_title()}, at ({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {heading}°")


@_onto.register
def _map_onto(record: VoxelMap, axes: Axes, *, side: str = "above") -> None:
    if side not in _SIDES:
        raise GeometryError(f"side: there is no {side!r}; give one of {', '.join(_SIDES)}")
    across, up, along, _ = _SIDES[side]
    axes.set(xlabel=_NAMES[across], ylabel=_NAMES[up], aspect="equal")
    axes.set_title(f"from {'' if side == 'above' else 'the '}{side}", fontsize=10)
    found = _relief(record, side)
    if found is None:
        axes.text(0.5, 0.5, "no voxel is occupied", ha="center", transform=axes.transAxes)
        return
    nearest, extent = found
    shown = axes.imshow(
        nearest.T, origin="lower", extent=extent, cmap="viridis", interpolation="nearest"
    )
    figure = axes.get_figure()
    assert figure is not None
    beside = axes.inset_axes((1.03, 0.0, 0.04, 1.0))  # as high as the map, whatever its shape
    figure.colorbar(shown, cax=beside, label=f"nearest voxel's {_NAMES[along]}")


@_onto.register
def _account_onto(record: Account, axes: Axes) -> None:
    _map_onto(record.voxels, axes)
    draw_ground(axes, record)
    for number, path in enumerate(record.paths, 1):
        x, y, _ = np.array([pose.position_m for pose in path.waypoints]).T
        axes.plot(x, y, ".-", color=scan_colour(number), ms=3, lw=1.4, label=f"scan {number}")
        axes.plot(x[:1], y[:1], "o", color=scan_colour(number), mec="w", ms=7)
    axes.autoscale()
    if record.paths:
        axes.legend(fontsize=8)
    axes.set_title(_headline(record), fontsize=10)


@_onto.register
def _run_onto(record: Run, axes: Axes) -> None:
    _account_onto(record.account(), axes)


@_onto.register
def _campaign_onto(
    record: Campaign,
    axes: Axes,
    *,
    score: str = HEADLINE,
    along: str = "path_m",
    setting: Mapping[str, str] = {},
) -> None:
    curves = record.curves
    for name, value in ({"score": score} | {"along": along}).items():
        if value not in curves.columns:
            raise ResultError(f"{name}: a campaign's curves have no column {value!r}")
    for name, value in setting.items():
        if name not in SETTING or value not in set(curves[name]):
            known = ", ".join(map(str, dict.fromkeys(curves.get(name, ())))) or ", ".join(SETTING)
            raise ResultError(f"{name}={value!r}: is not in the campaign; there is {known}")
        curves = curves[curves[name] == value]
    for name in SETTING:
        several = list(dict.fromkeys(curves[name]))
        if len(several) > 1:
            raise ResultError(
                f"curves of {len(several)} settings do not compare; choose one, as in "
                f"plot({name}={several[0]!r})"
            )
    curves_onto(axes, curves, score, along)
    axes.set_ylabel(score.replace("_", " "))
    axes.set_title(figure_text(record.title), fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


@singledispatch
def _told(record: Any) -> tuple[str, Facts, Sequence[Facts], list[bytes]]:
    """Title, figures, a table, and pictures of a record."""
    raise TypeError(f"{type(record).__name__} has no figures")


@_told.register
def _map_told(record: VoxelMap) -> tuple[str, Facts, Sequence[Facts], list[bytes]]:
    size_bytes = record.block_count * VOXELS_PER_BLOCK * BYTES_PER_VOXEL
    facts = {
        "voxel": f"{record.voxel_m:g} m",
        "observed": f"{record.count(lambda part: (part.seen & OBSERVED) > 0):,} voxels",
        "occupied": f"{record.count(lambda part: part.log_odds > 0):,} voxels",
        "occupied within": " x ".join(f"{size:.1f}" for size in _occupied_size_m(record)) + " m",
        "memory": f"{size_bytes / 1e6:,.1f} MB",
    }
    if any(record.origin_m):
        facts["origin"] = "({:,.1f}, {:,.1f}, {:,.1f}) m".format(*record.origin_m)
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    for axes, side in zip(figure.subplots(1, 3), _SIDES, strict=True):
        _map_onto(record, axes, side=side)
    return "Voxel map", facts, (), [png(figure)]


@_told.register
def _account_told(record: Account) -> tuple[str, Facts, Sequence[Facts], list[bytes]]:
    result = record.result
    facts: dict[str, object] = {
        "scenario": result.scenario,
        "planner, mapper": f"{short(result.planner)}, {short(result.mapper)}",
        "seed": result.seed,
        "flown": f"{result.scans} scans, {result.pings} pings, {result.path_m:.1f} m",
        "ended": result.why_stopped or result.stop_reason.sentence,
    }
    if result.vehicle is not None:
        facts["vehicle"] = f"{result.vehicle.name}, {result.vehicle.time_s:.0f} s"
    rows = [
        {"truth": kind} | {name: f"{scores['exact'][name]:.3f}" for name in _SCORES}
        for kind, scores in result.metrics.items()
    ]
    return "Scan", facts, rows, [picture(record)]


@_told.register
def _run_told(record: Run) -> tuple[str, Facts, Sequence[Facts], list[bytes]]:
    return _account_told(record.account())


@_told.register
def _campaign_told(record: Campaign) -> tuple[str, Facts, Sequence[Facts], list[bytes]]:
    facts: dict[str, object] = {"runs": len(record.runs), "failed": len(record.failed)}
    if not len(record.runs):
        return record.title or "Campaign", facts, (), []
    rows = [
        {name: _mean(value) if isinstance(value, dict) else value for name, value in row.items()}
        for row in summarise_campaign(record)
    ]
    for name in SETTING:
        if len({row[name] for row in rows}) == 1:  # it needs no column
            facts[name] = rows[0][name]
            rows = [{key: value for key, value in row.items() if key != name} for row in rows]
    settings = [group for _, group in record.curves.groupby(list(SETTING), sort=False)]
    label = HEADLINE.replace("_", " ")
    drawn = [draw_curves(group, HEADLINE, label) for group in settings[:_MOST_SETTINGS]]
    return record.title or "Campaign", facts, rows, [group[0][1] for group in drawn if group]


_SCORES = ("precision", "recall", "f1")


def _when(time_s: float) -> str:
    """A time as people say it; of a clock that counts from 1970, its day and hour."""
    if not _EPOCH_S < time_s < _LAST_S:
        return f"{time_s:.3f}".rstrip("0").rstrip(".") + " s"
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _headline(account: Account) -> str:
    result = account.result
    score = result.metrics["solid"]["exact"]["f1"]
    return figure_text(
        f"{result.scenario}, {short(result.planner)}: {result.scans} scans, "
        f"{result.path_m:.0f} m, F1 {score:.3f}"
    )


def _mean(value: Mapping[str, float | None]) -> str:
    half = value["ci95"]
    return f"{value['mean']:.3g}" + ("" if half is None else f" ± {half:.2g}")


def _size_in(record: Any) -> tuple[float, float]:
    return (6.4, 4.2) if isinstance(record, Campaign) else (6.6, 5.4)


def _occupied_size_m(voxels: VoxelMap) -> Float64:
    occupied = voxels.occupied_m()
    return np.ptp(occupied, axis=0) + voxels.voxel_m if len(occupied) else np.zeros(3)


def _relief(voxels: VoxelMap, side: str) -> tuple[Array, tuple[float, float, float, float]] | None:
    """Of each line of sight from a side, where along it the nearest occupied voxel lies.

    Returns:
        (across, up) metres, not a number where nothing is, and its extent; None of an empty map.
    """
    across, up, along, sign = _SIDES[side]
    points = voxels.occupied_m()
    if not len(points):
        return None
    points += voxels.origin_m
    flat = points[:, [across, up]]
    low = flat.min(axis=0) - voxels.voxel_m / 2
    count = max(np.ptp(flat, axis=0).max() / voxels.voxel_m + 1, 1.0)
    cell_m = voxels.voxel_m * math.ceil(count / _MOST_CELLS)
    index = ((flat - low) / cell_m).astype(int)
    nearest = np.full(index.max(axis=0) + 1, -np.inf)
    np.maximum.at(nearest, (index[:, 0], index[:, 1]), sign * points[:, along])
    high = low + np.array(nearest.shape) * cell_m
    nearest[np.isinf(nearest)] = np.nan
    return sign * nearest, (low[0], high[0], low[1], high[1])


def _cell(value: object) -> str:
    return escape(plain(str(value)))


def _th(name: str) -> str:
    return f'<th style="text-align:left">{_cell(name)}</th>'


def _td(value: object) -> str:
    return f'<td style="text-align:left">{_cell(value)}</td>'


def _rows(table: Sequence[Facts]) -> str:
    if not table:
        return ""
    head = "".join(map(_th, table[0]))
    body = "".join(f"<tr>{''.join(map(_td, row.values()))}</tr>" for row in table)
    return f"<table><tr>{head}</tr>{body}</table>"
