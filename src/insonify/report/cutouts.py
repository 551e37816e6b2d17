"""The sonar images around a voxel, one tile a ping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from insonify.mapping.pixels import Pixels
from insonify.mapping.voxels import probability_from_log_odds
from insonify.mission.explanation import Cutout, Glimpse
from insonify.report.fans import INK, png
from insonify.types import FanGeometry

COLUMNS = 4
_MARK = "#4cc9f0"
_UNKNOWN = "#6b7f99"
_TITLE = 48
"""Letters that fit over a tile."""


def draw_glimpses(glimpses: Sequence[Glimpse], title: str) -> bytes:
    """Tiles of what pings heard around a voxel, the pixels that it covers framed.

    Args:
        glimpses: With a cutout each; at least one.
        title: Over all of them.
    """
    rows = math.ceil(len(glimpses) / COLUMNS)
    figure = Figure(figsize=(12.6, 0.9 + 3.3 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    colours = colormaps["copper"].with_extremes(bad=_UNKNOWN)
    for axes, glimpse in zip(panels, glimpses, strict=False):
        assert glimpse.cutout is not None
        assert glimpse.pixels is not None
        cutout = glimpse.cutout
        picture = axes.imshow(
            cutout.image, origin="lower", aspect="auto", cmap=colours, vmin=0, vmax=1,
            extent=_edges(cutout), interpolation="nearest",
        )  # fmt: skip
        axes.add_patch(_frame(glimpse.pixels, cutout.geometry))
        _label(axes, glimpse)
    for axes in panels[len(glimpses) :]:
        axes.set_axis_off()
    figure.colorbar(picture, ax=panels.tolist(), label="intensity", shrink=0.8, aspect=40)
    figure.suptitle(title, fontsize=10, color=INK)
    return png(figure)


def _edges(cutout: Cutout) -> tuple[float, float, float, float]:
    """Azimuths of its left and right edge, degrees, and its least and greatest range, m."""
    bins, beams = cutout.image.shape
    first = Pixels(
        (cutout.first_beam, cutout.first_beam + beams - 1),
        (cutout.first_bin, cutout.first_bin + bins - 1),
        0.0, 0.0, 0.0, True, True,
    )  # fmt: skip
    return _extent(first, cutout.geometry)


def _extent(pixels: Pixels, geometry: FanGeometry) -> tuple[float, float, float, float]:
    (first, last), (near, far) = pixels.beams, pixels.bins
    left, right = (geometry.azimuth_fov_rad / 2 - b * geometry.beam_rad for b in (first, last + 1))
    low, high = (geometry.range_min_m + cell * geometry.bin_m for cell in (near, far + 1))
    return math.degrees(left), math.degrees(right), low, high


def _frame(pixels: Pixels, geometry: FanGeometry) -> Rectangle:
    left, right, low, high = _extent(pixels, geometry)
    return Rectangle((left, low), right - left, high - low, fill=False, ec=_MARK, lw=1.6)


def _label(axes: Axes, glimpse: Glimpse) -> None:
    assert glimpse.pixels is not None
    odds = np.array([glimpse.before, glimpse.shown.log_odds], np.float32)
    before, after = probability_from_log_odds(odds)
    axes.set_title(
        f"ping {glimpse.number}, {glimpse.time_s:.2f} s: {glimpse.pixels.range_m:.2f} m, "
        f"{math.degrees(glimpse.pixels.azimuth_rad):+.1f}°\n"
        f"{fill(glimpse.says, _TITLE)}\np {before:.3f} to {after:.3f}",
        fontsize=7.5, color=INK,
    )  # fmt: skip
    axes.set_xlabel("azimuth (port to starboard), °", fontsize=7)
    axes.set_ylabel("range, m", fontsize=7)
    axes.tick_params(labelsize=7)
