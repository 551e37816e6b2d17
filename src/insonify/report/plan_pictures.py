"""A planned scan as a picture: what is mapped, the way there and the scan, from above and aside."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from insonify.mapping.voxels import VoxelMap
from insonify.planning.decision import Decision
from insonify.report.fans import png
from insonify.types import Array, Box, Float64, Pose

_VIEWS = (("from above", 1, "y (north), m"), ("from the south", 2, "z (up), m"))
_MAPPED, _UNDECIDED, _WAY, _SCAN = "#8a949e", "#f2b27a", "#1f77b4", "#d95f02"


def draw_plan(voxels: VoxelMap, region: Box, decision: Decision, way: tuple[Pose, ...]) -> bytes:
    """A decision of a planner, as PNG.

    Args:
        voxels: The map, whose own frame all places are in; the picture is in the world's.
        region: Where uncertainty counts.
        decision: What the planner answered, with its cluster if it told.
        way: From the vehicle to the scan.
    """
    figure = Figure(figsize=(11.0, 5.4), layout="constrained")
    shift = np.array(voxels.origin_m)
    occupied = voxels.occupied_m() + shift
    cluster = np.empty((0, 3))
    if decision.look is not None:
        cluster = decision.look.cluster.voxels_m + shift
    scan = () if decision.path is None else decision.path.waypoints
    for axes, (title, up, label) in zip(figure.subplots(1, 2), _VIEWS, strict=True):
        _squares(axes, cluster[:, [0, up]], voxels.voxel_m, _UNDECIDED, "most undecided cluster")
        _squares(axes, occupied[:, [0, up]], voxels.voxel_m, _MAPPED, "occupied")
        low, high = (np.array(corner)[[0, up]] + shift[[0, up]]
                     for corner in (region.low_m, region.high_m))  # fmt: skip
        axes.add_patch(Rectangle(tuple(low), *(high - low), fill=False, ls=":", label="region"))
        _line(axes, _places(way, shift)[:, [0, up]], _WAY, "o--", "way there")
        _line(axes, _places(scan, shift)[:, [0, up]], _SCAN, "-", "scan")
        if up == 1:
            for pose, colour in ((way[0], _WAY), *((one, _SCAN) for one in scan[:1])):
                x, y = pose.x_m + shift[0], pose.y_m + shift[1]
                axes.quiver(x, y, np.cos(pose.yaw_rad), np.sin(pose.yaw_rad), color=colour,
                            width=0.008, scale=14, zorder=4)  # fmt: skip
        axes.set(title=title, xlabel="x (east), m", ylabel=label, aspect="equal")
        axes.margins(0.08)
        axes.grid(alpha=0.25)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5,
                  fontsize=9, frameon=False)  # fmt: skip
    return png(figure)


def _places(poses: tuple[Pose, ...], shift: Float64) -> Float64:
    return np.array([pose.position_m for pose in poses]).reshape(-1, 3) + shift


def _line(axes: Axes, places: Array, colour: str, style: str, label: str) -> None:
    if len(places):
        axes.plot(
            places[:, 0], places[:, 1], style, color=colour, ms=4, lw=2, label=label, zorder=3
        )


def _squares(axes: Axes, places: Array, size_m: float, colour: str, label: str) -> None:
    """Voxels seen from a side, those behind each other once."""
    if not len(places):
        return
    cells = np.unique(np.round(places / size_m * 2.0), axis=0) / 2.0 * size_m
    squares = [Rectangle(tuple(cell - size_m / 2), size_m, size_m) for cell in cells]
    axes.add_collection(PatchCollection(squares, facecolor=colour, lw=0))
    axes.plot([], [], "s", color=colour, label=label)
    axes.update_datalim(cells)
