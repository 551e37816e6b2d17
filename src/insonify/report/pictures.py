"""Pictures of what a run decided and mapped, as PNG bytes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from insonify.mission.account import Account
from insonify.planning.decision import DecisionRecord, Look
from insonify.report.colours import (
    BLUE,
    CORRECT,
    FALSE_ALARM,
    INK,
    MISSED,
    ORANGE,
    SKY,
    SOFT,
    UNSEEN,
)
from insonify.report.courses import NAMES, draw_outline, draw_region
from insonify.report.fans import png
from insonify.types import Array, Bool, Float64

_HALO = [patheffects.withStroke(linewidth=2.2, foreground="w")]


def draw_ground(axes: Axes, account: Account) -> None:
    """What every picture from above shows: the object's outline and the designated area."""
    draw_outline(axes, account)
    draw_region(axes, account)
    _map_axes(axes)


def draw_undecided(account: Account, record: DecisionRecord) -> bytes:
    """What was undecided from above, the largest cluster, and where a scan could look from."""
    figure = Figure(figsize=(5.4, 4.6), layout="constrained")
    axes = figure.add_subplot()
    low, high = account.region.low_m, account.region.high_m
    x0, x1, y0, y1 = low[0], high[0], low[1], high[1]
    axes.fill([x0, x1, x1, x0], [y0, y0, y1, y1], color=UNSEEN, zorder=-1)
    assert record.entropy_bits is not None
    picture = axes.imshow(
        record.entropy_bits.T, origin="lower", extent=(x0, x1, y0, y1), cmap="magma"
    )
    bar = figure.colorbar(picture, ax=axes, shrink=0.75, pad=0.02)
    bar.set_label("entropy above each cell, bits", fontsize=9)
    draw_outline(axes, account, colour="w")
    path, look = record.decision.path, record.decision.look
    if path is not None:
        ends = (path.waypoints[0], path.waypoints[-1])
        way = np.array([pose.position_m for pose in ends])
        axes.plot(way[:, 0], way[:, 1], "-", color="w", lw=4.4, zorder=2)
        axes.plot(way[:, 0], way[:, 1], "-", color=BLUE, lw=2.4, zorder=2)
    if look is not None:
        _draw_look(axes, look, chosen=path is not None)
    _map_axes(axes)
    return png(figure)


def draw_candidates(record: DecisionRecord) -> bytes:
    """What each candidate would show of the largest cluster, against what a scan must show."""
    look = record.decision.look
    assert look is not None
    figure = Figure(figsize=(5.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    share = 100.0 * look.h_cluster / look.cluster.entropy
    needed = 100.0 * look.termination
    chosen = look.best if record.decision.path is not None else None
    colours = [BLUE if k == chosen else SOFT for k in range(len(share))]
    axes.bar(range(len(share)), share, color=colours)
    axes.axhline(needed, color=ORANGE, lw=1.8, ls="--")
    axes.text(
        len(share) - 0.5, needed, f"a scan must show more than {needed:.3g} %", color=ORANGE,
        ha="right", va="bottom", fontsize=9.5, path_effects=_HALO,
    )  # fmt: skip
    if chosen is not None:
        axes.text(
            look.best, share[look.best], f"{share[look.best]:.0f} %", color=BLUE, ha="center",
            va="bottom", fontsize=9.5,
        )  # fmt: skip
    axes.set(
        xlabel="candidate", ylabel="of the largest cluster's entropy, %",
        ylim=(0, max(5.0, 1.15 * max(float(share.max()), needed))), xlim=(-0.8, len(share) - 0.2),
    )  # fmt: skip
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.spines[["top", "right"]].set_visible(False)
    return png(figure)


def draw_slices(account: Account) -> list[tuple[str, bytes]]:
    """The map against the solid truth in three heights and two upright sections, each named."""
    truth = account.truth
    reconstructed = account.voxels.window(truth.box).occupied & truth.scored
    actual = truth.solid & truth.scored
    kinds = reconstructed.astype(np.int8) + 2 * actual.astype(np.int8)
    return [(name, _slice(account, kinds, axis, at)) for name, axis, at in _cuts(account, actual)]


def _cuts(account: Account, actual: Bool) -> Iterator[tuple[str, int, int]]:
    """Where to cut: a name, the axis, and which layer along it."""
    low, voxel_m = account.truth.box.low_m, account.voxels.voxel_m
    layers = np.flatnonzero(actual.any(axis=(0, 1)))
    cuts = [(2, int(layers[len(layers) * part // 6])) for part in (1, 3, 5) if len(layers)]
    cuts += [(axis, actual.shape[axis] // 2) for axis in (1, 0)]
    for axis, layer in cuts:
        yield f"{'xyz'[axis]} = {low[axis] + (layer + 0.5) * voxel_m:.2f} m", axis, layer


def _slice(account: Account, kinds: Array, axis: int, layer: int) -> bytes:
    across, up = (k for k in range(3) if k != axis)
    box = account.truth.box
    size = np.array(box.high_m) - np.array(box.low_m)
    height_in = min(max(2.1 * size[up] / size[across], 1.0), 4.2) + 0.5
    figure = Figure(figsize=(2.7, height_in), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(
        kinds.take(layer, axis=axis).T, origin="lower", vmin=0, vmax=3, interpolation="nearest",
        cmap=ListedColormap(["#f3f5f7", FALSE_ALARM, MISSED, CORRECT]),
        extent=(box.low_m[across], box.high_m[across], box.low_m[up], box.high_m[up]),
    )  # fmt: skip
    axes.set_xlabel(NAMES[across], fontsize=9)
    axes.set_ylabel(NAMES[up], fontsize=9)
    axes.tick_params(labelsize=8)
    return png(figure)


def voxel_shell(filled: Bool, first_m: Float64, voxel_m: float) -> tuple[Float64, Array]:
    """The outer faces of a set of voxels as triangles, faces in a row joined to one.

    Args:
        filled: (nx, ny, nz).
        first_m: World position of the lower corner of voxel [0, 0, 0].
        voxel_m: Edge length.

    Returns:
        Vertices (N, 3) metres and faces (M, 3).
    """
    padded = np.pad(filled, 1)
    corners = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        for step in (0, 1):
            neighbour = np.roll(padded, 1 - 2 * step, axis)[1:-1, 1:-1, 1:-1]
            first, length = _rows(filled & ~neighbour, (axis + 1) % 3)
            base, along = first + step * np.eye(3, dtype=int)[axis], length[:, None] * u
            around = [0 * along, along, along + v, v + 0 * along]
            around = around if step else [around[0], around[3], around[2], around[1]]
            corners.append(np.stack([base + corner for corner in around], axis=1).reshape(-1, 3))
    grid, which = np.unique(np.concatenate(corners).astype(np.int32), axis=0, return_inverse=True)
    square = np.array([[0, 1, 2], [0, 2, 3]])
    faces = (np.arange(len(which) // 4)[:, None, None] * 4 + square).reshape(-1, 3)
    return grid * voxel_m + first_m, which.reshape(-1)[faces]


def _rows(cells: Bool, axis: int) -> tuple[Array, Array]:
    """Rows of cells along an axis: the first cell (N, 3) of each, and how many there are."""
    lines = np.moveaxis(cells, axis, 2)
    steps = np.diff(np.pad(lines, ((0, 0), (0, 0), (1, 1))).astype(np.int8), axis=2)
    starts, ends = np.argwhere(steps == 1), np.argwhere(steps == -1)
    first = np.insert(starts[:, :2], axis, starts[:, 2], axis=1)
    return first, ends[:, 2] - starts[:, 2]


def _draw_look(axes: Axes, look: Look, *, chosen: bool) -> None:
    axes.use_sticky_edges = False  # candidates keep clear of the frame
    cluster = look.cluster
    cells = np.unique(cluster.voxels_m[:, :2].round(6), axis=0)
    axes.plot(cells[:, 0], cells[:, 1], ".", ms=1.4, color=SKY, alpha=0.3)
    share = look.h_cluster / cluster.entropy
    x = [pose.x_m for pose in look.candidates]
    y = [pose.y_m for pose in look.candidates]
    most = max(float(share.max()), look.termination)
    axes.scatter(x, y, c=share, cmap="Blues", vmin=0, vmax=most, s=40, ec=INK, lw=0.7, zorder=3)
    for number, pose in enumerate(look.candidates):
        axes.annotate(
            str(number), (pose.x_m, pose.y_m), (5, 3), textcoords="offset points", fontsize=8,
            color=INK, zorder=4, path_effects=_HALO,
        )  # fmt: skip
    axes.plot(*cluster.centre_m[:2], "x", color=SKY, ms=9, mew=2.4)
    if chosen:
        axes.plot(x[look.best], y[look.best], "o", mfc="none", mec=BLUE, ms=13, mew=2.2)


def _map_axes(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set(xlabel=NAMES[0], ylabel=NAMES[1])
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.2)
