"""Pictures of a map by itself, without a truth to hold it against: named PNG bytes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insonify.mapping.voxels import VoxelWindow
from insonify.planning.entropy import entropy_map
from insonify.report.colours import ORANGE
from insonify.report.courses import NAMES, View
from insonify.report.fans import png
from insonify.types import Array, Pose

Named = tuple[str, bytes]

_VIEWS = {"from above": View(0, 1), "from the south": View(0, 2), "from the east": View(1, 2)}
_NOTHING = "#e8ecef"
_WIDTH_IN = 4.6


def draw_occupancy(window: VoxelWindow, poses: list[Pose]) -> Iterator[Named]:
    """How many occupied voxels lie one behind the other, from three sides, and the path."""
    positions = np.array([pose.position_m for pose in poses]).reshape(-1, 3)
    for name, view in _VIEWS.items():
        depth = window.occupied.sum(axis=view.along).astype(float)
        depth[depth == 0] = np.nan
        figure, axes = _drawn(
            window, depth, view, "occupied voxels in a row", cmap="viridis_r", vmin=0
        )
        limits = axes.axis()
        axes.plot(positions[:, view.across], positions[:, view.up], "-", color=ORANGE, lw=1.4)
        axes.axis(limits)
        yield name, png(figure)


def draw_entropy(window: VoxelWindow) -> Iterator[Named]:
    """Mean entropy of the voxels that were in view along each line, from three sides."""
    entropy = np.where(window.seen > 0, entropy_map(window), np.nan)
    seen = np.isfinite(entropy)
    for name, view in _VIEWS.items():
        total = np.where(seen, entropy, 0.0).sum(axis=view.along)
        mean = np.divide(total, seen.sum(axis=view.along), where=seen.any(axis=view.along),
                         out=np.full(total.shape, np.nan))  # fmt: skip
        figure, _ = _drawn(
            window, mean, view, "mean entropy in view, bits", cmap="magma", vmin=0, vmax=1
        )
        yield name, png(figure)


def draw_slices(window: VoxelWindow) -> Iterator[Named]:
    """Probability and entropy in the three planes through the middle of the occupied voxels."""
    occupied = np.argwhere(window.occupied)
    shape = np.array(window.occupied.shape)
    centre = np.median(occupied, axis=0).astype(int) if len(occupied) else shape // 2
    seen = window.seen > 0
    layers = (
        ("probability", np.where(seen, window.probability, np.nan), "cividis"),
        ("entropy, bits", np.where(seen, entropy_map(window), np.nan), "magma"),
    )
    for label, values, colours in layers:
        for view in _VIEWS.values():
            along = view.along
            section = values.take(centre[along], axis=along)
            where = (window.first[along] + centre[along] + 0.5) * window.voxel_m
            figure, _ = _drawn(window, section, view, label, cmap=colours, vmin=0, vmax=1)
            yield f"{label.partition(',')[0]} at {'xyz'[along]} = {where:.2f} m", png(figure)


def _drawn(
    window: VoxelWindow, values: Array, view: View, label: str, **look: Any
) -> tuple[Figure, Axes]:
    """Values over a view of a window, to scale, with a colour bar under them."""
    low = np.array(window.first) * window.voxel_m
    high = low + np.array(window.occupied.shape) * window.voxel_m
    size = (high - low)[[view.across, view.up]]
    height_in = min(max((_WIDTH_IN - 0.7) * size[1] / size[0], 0.6), 5.0) + 1.3
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    axes = figure.add_subplot(facecolor=_NOTHING)
    extent = (low[view.across], high[view.across], low[view.up], high[view.up])
    picture = axes.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **look)
    bar = figure.colorbar(picture, ax=axes, location="bottom", shrink=0.8, aspect=32)
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    axes.set(xlabel=NAMES[view.across], ylabel=NAMES[view.up])
    axes.tick_params(labelsize=8)
    return figure, axes
