"""Pictures of a run, as PNG bytes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_hex
from matplotlib.figure import Figure

from insonify.evaluation import GroundTruth
from insonify.mission.account import Account
from insonify.mission.result import ScanResult
from insonify.planning.decision import DecisionRecord, Look
from insonify.report.fans import INK, png
from insonify.types import Array, Bool, Box, Float64

TRUE_POSITIVE, FALSE_POSITIVE, MISS = "#2a9d57", "#d1495b", "#3066be"
UNSEEN = "#aab4be"


def scan_colour(number: int) -> str:
    """The colour of a scan, counted from 1, in every picture of it."""
    return to_hex(f"C{(number - 1) % 10}")


def draw_trajectory(account: Account) -> bytes:
    """The scans from above, numbered, over the object's outline (Fig. 5 and 6)."""
    figure = Figure(figsize=(7.2, 6.2))
    axes = figure.add_subplot()
    _draw_outline(axes, account.truth)
    _draw_region(axes, account.region)
    for number, path in enumerate(account.paths, 1):
        x = [pose.x_m for pose in path.waypoints]
        y = [pose.y_m for pose in path.waypoints]
        colour = scan_colour(number)
        axes.plot(x, y, ".-", color=colour, ms=3, lw=1.2, label=f"scan {number}")
        axes.annotate(
            "",
            (x[-1], y[-1]),
            (x[max(0, len(x) - 4)], y[max(0, len(y) - 4)]),
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.5},
        )
        axes.text(
            x[0], y[0], str(number), color="w", fontsize=9, ha="center", va="center",
            bbox={"boxstyle": "circle", "fc": colour, "ec": "none"},
        )  # fmt: skip
    _map_axes(axes)
    axes.legend(fontsize=8, loc="best")
    return png(figure)


def draw_ground(axes: Axes, account: Account) -> None:
    """What every picture from above shows: the object's outline and the designated area."""
    _draw_outline(axes, account.truth)
    _draw_region(axes, account.region)
    _map_axes(axes)


def draw_decision(account: Account, record: DecisionRecord, after: int) -> bytes:
    """The entropy map after a scan, with C_max and the candidates and what each would see."""
    figure = Figure(figsize=(10.2, 5.0))
    axes, bars = figure.subplots(1, 2, width_ratios=(1.5, 1))
    low, high = account.region.low_m, account.region.high_m
    x0, x1, y0, y1 = low[0], high[0], low[1], high[1]
    axes.fill([x0, x1, x1, x0], [y0, y0, y1, y1], color=UNSEEN, zorder=-1)
    assert record.entropy_bits is not None
    picture = axes.imshow(
        record.entropy_bits.T,
        origin="lower",
        extent=(x0, x1, y0, y1),
        cmap="magma",
    )
    figure.colorbar(picture, ax=axes, label="entropy above each cell, bits", shrink=0.8)
    _draw_outline(axes, account.truth, "w")
    look = record.decision.look
    if look is not None:
        _draw_look(axes, look)
        _draw_scores(bars, look)
    else:
        bars.set_axis_off()
        bars.text(0.5, 0.5, "no cluster", ha="center")
    path = record.decision.path
    if path is not None:
        ends = (path.waypoints[0], path.waypoints[-1])
        axes.plot([p.x_m for p in ends], [p.y_m for p in ends], "-", color="#35d07f", lw=2)
    verdict = f"scan {after + 1} chosen" if path is not None else "stop"
    axes.set_title(f"Entropy after scan {after}: {verdict}", fontsize=10, color=INK)
    _map_axes(axes)
    return png(figure)


def draw_slices(account: Account) -> bytes:
    """The map against the solid truth in three heights and two upright sections."""
    truth = account.truth
    reconstructed = account.voxels.window(truth.box).occupied & truth.scored
    actual = truth.solid & truth.scored
    kinds = reconstructed.astype(np.int8) + 2 * actual.astype(np.int8)
    colours = ListedColormap(["#f3f5f7", FALSE_POSITIVE, MISS, TRUE_POSITIVE])
    low, high = truth.box.low_m, truth.box.high_m
    figure = Figure(figsize=(13.5, 4.2), layout="constrained")
    panels = figure.subplots(1, 5)
    layers = np.flatnonzero(actual.any(axis=(0, 1)))
    heights = [int(layers[len(layers) * part // 6]) for part in (1, 3, 5) if len(layers)]
    voxel_m = account.voxels.voxel_m
    for axes, layer in zip(panels, heights, strict=False):
        axes.imshow(
            kinds[:, :, layer].T, origin="lower", cmap=colours, vmin=0, vmax=3,
            extent=(low[0], high[0], low[1], high[1]),
        )  # fmt: skip
        axes.set_title(f"z = {low[2] + (layer + 0.5) * voxel_m:.2f} m", fontsize=9)
        axes.set(xlabel="x (east), m", ylabel="y (north), m")
    for axes, axis in zip(panels[3:], (1, 0), strict=True):
        middle = kinds.shape[axis] // 2
        axes.imshow(
            kinds.take(middle, axis=axis).T, origin="lower", cmap=colours, vmin=0, vmax=3,
            extent=(low[1 - axis], high[1 - axis], low[2], high[2]),
        )  # fmt: skip
        where = low[axis] + (middle + 0.5) * voxel_m
        axes.set_title(f"{'xy'[axis]} = {where:.2f} m", fontsize=9)
        axes.set(xlabel=f"{'xy'[1 - axis]}, m", ylabel="z (up), m")
    for axes in panels:
        axes.tick_params(labelsize=7)
    return png(figure)


def draw_history(result: ScanResult) -> bytes:
    """Scores and total entropy after each scan."""
    figure = Figure(figsize=(9.6, 3.4))
    scores, entropy = figure.subplots(1, 2)
    scans = [entry.scan for entry in result.history]
    for kind, style in (("solid", "-o"), ("surface", "--s")):
        for name, colour in (("precision", "C0"), ("recall", "C1"), ("f1", "C2")):
            values = [entry.metrics[kind]["exact"][name] for entry in result.history]
            scores.plot(scans, values, style, color=colour, ms=4, label=f"{kind} {name}")
    scores.set(ylim=(0, 1), xlabel="scan", title="exact scores")
    scores.legend(fontsize=7, ncols=2)
    entropy.plot(
        scans, [entry.total_entropy_bits / 1000 for entry in result.history], "-o", color=INK
    )
    entropy.set(xlabel="scan", title="entropy of the designated area, kbit")
    for axes in (scores, entropy):
        axes.set_xticks(scans)
        axes.grid(alpha=0.3)
    return png(figure)


def voxel_shell(filled: Bool, first_m: Float64, voxel_m: float) -> tuple[Float64, Array]:
    """The outer faces of a set of voxels as a triangle mesh.

    Args:
        filled: (nx, ny, nz).
        first_m: World position of the lower corner of voxel [0, 0, 0].
        voxel_m: Edge length.

    Returns:
        Vertices (N, 3) metres and faces (M, 3).
    """
    padded = np.pad(filled, 1)
    corners, count = [], 0
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for step in (0, 1):
            neighbour = np.roll(padded, 1 - 2 * step, axis)[1:-1, 1:-1, 1:-1]
            base = np.argwhere(filled & ~neighbour) + step * np.eye(3)[axis]
            around = [0 * u, u, u + v, v] if step else [0 * u, v, u + v, u]  # normals outwards
            quads = base[:, None, :] + np.stack(around)
            corners.append(quads.reshape(-1, 3))
            count += len(base)
    grid, which = np.unique(np.concatenate(corners).astype(np.int32), axis=0, return_inverse=True)
    square = np.array([[0, 1, 2], [0, 2, 3]])
    faces = (np.arange(count)[:, None, None] * 4 + square).reshape(-1, 3)
    return grid * voxel_m + first_m, which.reshape(-1)[faces]


def _draw_look(axes: Axes, look: Look) -> None:
    cluster = look.cluster
    cells = np.unique(cluster.voxels_m[:, :2].round(6), axis=0)
    axes.plot(cells[:, 0], cells[:, 1], ".", ms=1.2, color="#4cc9f0", alpha=0.25)
    share = look.h_cluster / cluster.entropy
    x = [pose.x_m for pose in look.candidates]
    y = [pose.y_m for pose in look.candidates]
    axes.scatter(x, y, c=share, cmap="viridis", vmin=0, s=34, ec="w", lw=0.6, zorder=3)
    for number, pose in enumerate(look.candidates):
        axes.text(pose.x_m, pose.y_m, f" {number}", fontsize=6.5, color=INK)
    axes.plot(*cluster.centre_m[:2], "x", color="#4cc9f0", ms=9, mew=2.4)
    axes.plot(x[look.best], y[look.best], "o", mfc="none", mec="#35d07f", ms=12, mew=2)


def _draw_scores(axes: Axes, look: Look) -> None:
    termination = look.termination
    share = look.h_cluster / look.cluster.entropy
    colours = ["#35d07f" if i == look.best else "#7a8794" for i in range(len(share))]
    axes.bar(range(len(share)), share, color=colours)
    axes.axhline(termination, color=FALSE_POSITIVE, lw=1.2, ls="--")
    axes.text(1.01, termination, "TC", color=FALSE_POSITIVE, transform=axes.get_yaxis_transform())
    axes.set_title(
        f"H_sum / H_total of C_max ({look.cluster.entropy:.0f} bits,\n"
        f"{len(look.cluster.voxels_m)} voxels, radius {look.cluster.radius_m:.1f} m)",
        fontsize=9,
        color=INK,
    )
    axes.set(xlabel="candidate", ylim=(0, max(0.05, 1.15 * max(float(share.max()), termination))))


def _draw_outline(axes: Axes, truth: GroundTruth, colour: str = INK) -> None:
    low, high = truth.box.low_m, truth.box.high_m
    seen_from_above = truth.solid.any(axis=2).T.astype(float)
    axes.contour(
        np.linspace(low[0], high[0], seen_from_above.shape[1]),
        np.linspace(low[1], high[1], seen_from_above.shape[0]),
        seen_from_above,
        [0.5],
        colors=[colour],
        linewidths=1.0,
    )


def _draw_region(axes: Axes, region: Box) -> None:
    (x0, y0, _), (x1, y1, _) = region.low_m, region.high_m
    axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], ":", color="#7a8794", lw=1)


def _map_axes(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set(xlabel="x (east), m", ylabel="y (north), m")
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.2)
