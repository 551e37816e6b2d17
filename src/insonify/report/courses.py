"""Where a scan went, from above and from the side, as PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insonify.evaluation import Solid
from insonify.frames import directions_from_angles, world_from_sonar
from insonify.mission.account import Account
from insonify.report.colours import INK, SOFT, scan_colour
from insonify.report.fans import png
from insonify.types import Array, Float32, Float64, PosedPing

NAMES = ("x (east), m", "y (north), m", "z (up), m")
LONG = 1.7
"""How many times as long as wide a course is that takes a page's whole width."""
_SEABED = "#cfc4ad"
_BINS = 160
_FRAME_IN = (0.75, 0.6)
"""What labels take of a picture's width and height."""
_FLATTEST, _STEEPEST = 0.2, 0.85
_WIDTH, _WIDER = 1.8, 1.7
"""Of a line, and for each scan that comes after it, so that none hides the one before."""


@dataclass(frozen=True, slots=True)
class View:
    """A look along an axis: which coordinates go across and up the picture."""

    across: int
    up: int

    @property
    def along(self) -> int:
        """The axis looked along."""
        return 3 - self.across - self.up


ABOVE = View(0, 1)


def side_of(account: Account) -> View:
    """From the side on which the course is longest: from the south, or from the east."""
    x_m, y_m, _ = np.ptp(_places(account), axis=0)
    return View(0, 2) if x_m >= y_m else View(1, 2)


def is_long(account: Account) -> bool:
    """Whether the course is best drawn across a whole page."""
    x_m, y_m, _ = np.ptp(_places(account), axis=0)
    return bool(max(x_m, y_m) > LONG * min(x_m, y_m))


def draw_course(account: Account, view: View, width_in: float) -> bytes:
    """The scans in order, numbered where they begin, and the ways between them.

    Args:
        account: Of the run.
        view: From above, or from a side.
        width_in: Of the picture; its height is what the course needs.
    """
    places = _places(account)[:, (view.across, view.up)]
    low, high = places.min(axis=0), places.max(axis=0)
    if view is not ABOVE:
        low[1] = min(low[1], _seabed_top(account, low[1]))
    margin = 0.05 * (high - low)[0], 0.16 * (high - low)[1]
    low, high = low - margin, high + margin
    across, up = high - low
    ratio = min(max(up / across, _FLATTEST), _STEEPEST)
    grown = np.array([max(up / ratio, across), max(across * ratio, up)]) - (high - low)
    low, high = low - grown / 2, high + grown / 2
    height_in = (width_in - _FRAME_IN[0]) * ratio + _FRAME_IN[1]
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    _draw_ground(axes, account, view)
    if view is not ABOVE:
        _draw_beams(axes, account.keyframes, view)
    _draw_between(axes, account, view)
    for number, path in enumerate(account.paths, 1):
        way = np.array([pose.position_m for pose in path.waypoints])[:, (view.across, view.up)]
        _draw_scan(axes, number, way, _WIDTH + _WIDER * min(3, len(account.paths) - number))
    axes.set(xlabel=NAMES[view.across], ylabel=NAMES[view.up])
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.2)
    return png(figure)


def draw_outline(axes: Axes, account: Account, view: View = ABOVE, colour: str = INK) -> None:
    """The true object's silhouette."""
    truth = account.truth
    low, high = truth.box.low_m, truth.box.high_m
    seen = truth.solid.any(axis=view.along)
    steps = [np.linspace(low[k], high[k], n + 1) for k, n in
             zip((view.across, view.up), seen.shape, strict=True)]  # fmt: skip
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in steps]
    if seen.any():
        axes.contour(*middles, seen.T.astype(float), [0.5], colors=[colour], linewidths=1.2)


def draw_region(axes: Axes, account: Account, view: View = ABOVE) -> None:
    """The designated area, dotted."""
    low, high = account.region.low_m, account.region.high_m
    (x0, x1), (y0, y1) = ((low[k], high[k]) for k in (view.across, view.up))
    axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], ":", color=INK, lw=1.1)


def _places(account: Account) -> Float64:
    """All that a picture of the course must hold, (N, 3)."""
    flown = [pose.position_m for path in account.paths for pose in path.waypoints]
    flown += [moment.estimated.position_m for moment in account.moments]
    return np.array([*flown, account.region.low_m, account.region.high_m])


def _draw_ground(axes: Axes, account: Account, view: View) -> None:
    draw_region(axes, account, view)
    draw_outline(axes, account, view)
    if view is ABOVE:
        return
    for solid in account.solids:
        if solid.name == "seabed":
            at, top = _profile(_seabed(solid), view.across)
            axes.fill_between(at, top, top.min() - 100.0, color=_SEABED, lw=0, zorder=-1)


def _seabed_top(account: Account, otherwise: float) -> float:
    """How low a picture from the side must reach to show the seabed."""
    heights = [np.median(_seabed(s)[:, 2]) for s in account.solids if s.name == "seabed"]
    return float(min(heights, default=otherwise))


def _seabed(solid: Solid) -> Float32:
    """Its vertices as files keep them, so that a report of the files is that of the run."""
    return np.asarray(solid.vertices, np.float32)


def _profile(vertices: Float32, across: int) -> tuple[Float64, Float64]:
    """The seabed's mean height along an axis."""
    at = vertices[:, across]
    edges = np.linspace(at.min(), at.max(), _BINS + 1)
    cell = np.clip(np.digitize(at, edges) - 1, 0, _BINS - 1)
    count = np.bincount(cell, minlength=_BINS)
    total = np.bincount(cell, vertices[:, 2], minlength=_BINS)
    known = count > 0
    return ((edges[1:] + edges[:-1]) / 2)[known], total[known] / count[known]


def _draw_beams(axes: Axes, keyframes: Sequence[tuple[int, PosedPing]], view: View) -> None:
    """What the sonar insonified in the middle of its first scan, as a wedge."""
    middle = keyframes[len([scan for scan, _ in keyframes if scan == 1]) // 2 :]
    if not middle or middle[0][1].pose is None:
        return
    scan, posed = middle[0]
    assert posed.pose is not None
    geometry = posed.ping.geometry
    half = geometry.elevation_fov_rad / 2
    world = world_from_sonar(posed.pose, geometry.mount)
    elevations = np.linspace(-half, half, 25)
    ends = geometry.range_max_m * directions_from_angles(np.zeros(25), elevations)
    corners = np.vstack([np.zeros((1, 3)), ends]) @ world[:3, :3].T + world[:3, 3]
    shown: Array = corners[:, (view.across, view.up)]
    axes.fill(*shown.T, color=scan_colour(scan), alpha=0.13, lw=0, zorder=0)


def _draw_between(axes: Axes, account: Account, view: View) -> None:
    """The ways between scans: as they were flown, or straight without a vehicle."""
    if account.moments:
        track = np.array([moment.estimated.position_m for moment in account.moments])
        axes.plot(track[:, view.across], track[:, view.up], "-", color=SOFT, lw=1.1, zorder=1)
        return
    for path, following in zip(account.paths, account.paths[1:], strict=False):
        ends = (path.waypoints[-1].position_m, following.waypoints[0].position_m)
        way = np.array(ends)[:, (view.across, view.up)]
        axes.plot(*way.T, "--", color=INK, lw=1.0, zorder=3)


def _draw_scan(axes: Axes, number: int, way: Float64, width: float) -> None:
    colour = scan_colour(number)
    axes.plot(*way.T, "-", color=colour, lw=width, solid_capstyle="butt", zorder=2)
    if len(way) > 1:
        axes.annotate(
            "", way[-1], way[max(0, len(way) - 4)],
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6, "mutation_scale": 14},
        )  # fmt: skip
    axes.annotate(
        str(number), way[0], color="w", fontsize=9, ha="center", va="center", zorder=4,
        bbox={"boxstyle": "circle,pad=0.25", "fc": colour, "ec": "w", "lw": 0.8},
    )  # fmt: skip
