"""Pictures of a map by itself, without a truth to hold it against, as PNG bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from insonify.mapping.voxels import VoxelWindow
from insonify.planning.entropy import entropy_map
from insonify.report.fans import png
from insonify.types import Array, Pose

_VIEWS = (("from above", 0, 1, 2), ("from the south", 0, 2, 1), ("from the east", 1, 2, 0))
_NAMES = ("x (east), m", "y (north), m", "z (up), m")
_NOTHING = "#e8ecef"


def draw_occupancy(window: VoxelWindow, poses: list[Pose]) -> bytes:
    """How many occupied voxels lie one behind the other, from three sides, and the path."""
    figure = Figure(figsize=(15.0, 5.2), layout="constrained")
    for axes, (title, across, up, along) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        depth = window.occupied.sum(axis=along).astype(float)
        depth[depth == 0] = np.nan
        picture = _show(axes, window, depth, across, up, cmap="viridis_r", vmin=0)
        figure.colorbar(picture, ax=axes, label="occupied voxels in a row", shrink=0.7)
        positions = np.array([pose.position_m for pose in poses]).reshape(-1, 3)
        limits = axes.axis()
        axes.plot(positions[:, across], positions[:, up], "-", color="#d1495b", lw=1)
        axes.axis(limits)
        axes.set_title(title, fontsize=10)
    return png(figure)


def draw_entropy(window: VoxelWindow) -> bytes:
    """Mean entropy of the voxels that were in view along each line, from three sides."""
    figure = Figure(figsize=(15.0, 5.2), layout="constrained")
    entropy = np.where(window.seen > 0, entropy_map(window), np.nan)
    for axes, (title, across, up, along) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        seen = np.isfinite(entropy)
        total = np.where(seen, entropy, 0.0).sum(axis=along)
        mean = np.divide(total, seen.sum(axis=along), where=seen.any(axis=along),
                         out=np.full(total.shape, np.nan))  # fmt: skip
        picture = _show(axes, window, mean, across, up, cmap="magma", vmin=0, vmax=1)
        figure.colorbar(picture, ax=axes, label="mean entropy in view, bits", shrink=0.7)
        axes.set_title(title, fontsize=10)
    return png(figure)


def draw_slices(window: VoxelWindow) -> bytes:
    """Probability and entropy in the three planes through the middle of the occupied voxels."""
    occupied = np.argwhere(window.occupied)
    shape = np.array(window.occupied.shape)
    centre = np.median(occupied, axis=0).astype(int) if len(occupied) else shape // 2
    figure = Figure(figsize=(15.0, 9.6), layout="constrained")
    panels = figure.subplots(2, 3)
    seen = window.seen > 0
    layers = (
        ("probability", np.where(seen, window.probability, np.nan), "coolwarm"),
        ("entropy, bits", np.where(seen, entropy_map(window), np.nan), "magma"),
    )
    for row, (name, values, colours) in zip(panels, layers, strict=True):
        for axes, (_, across, up, along) in zip(row, _VIEWS, strict=True):
            section = values.take(centre[along], axis=along)
            picture = _show(axes, window, section, across, up, cmap=colours, vmin=0, vmax=1)
            where = (window.first[along] + centre[along] + 0.5) * window.voxel_m
            axes.set_title(f"{name}, {'xyz'[along]} = {where:.2f} m", fontsize=10)
            figure.colorbar(picture, ax=axes, shrink=0.7)
    return png(figure)


def _show(
    axes: Axes, window: VoxelWindow, values: Array, across: int, up: int, **look: Any
) -> AxesImage:
    low = np.array(window.first) * window.voxel_m
    high = low + np.array(window.occupied.shape) * window.voxel_m
    axes.set_facecolor(_NOTHING)
    picture = axes.imshow(
        values.T,
        origin="lower",
        extent=(low[across], high[across], low[up], high[up]),
        interpolation="nearest",
        **look,
    )
    axes.set(xlabel=_NAMES[across], ylabel=_NAMES[up])
    axes.tick_params(labelsize=8)
    return picture
