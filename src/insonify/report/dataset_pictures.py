"""The picture of what a dataset holds, as PNG bytes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insonify.names import figure_text
from insonify.report.fans import INK, png
from insonify.types import Array, Float64

SIZES = 24
"""Steps of a mask's share of its image, from 1e-6 to 1 in equal steps of the logarithm."""
_MOST_CATEGORIES = 20
_MOST_POINTS = 20_000


@dataclass(slots=True, eq=False)
class DatasetFigures:
    """What is counted of a dataset.

    Attributes:
        title: Of the picture.
        categories: Their names.
        parts: Names of the parts that have views.
        range_m: From the nearest to the farthest bin.
        views: (parts, categories) how many views of a part show a category.
        total: (parts,) how many views it has.
        pixels: (categories,) how many show it.
        sizes: (categories, SIZES) its masks by their share of the image.
        ranges: (categories, slices) its pixels by range.
        levels: (slices,) all pixels by intensity.
        places: x, y and the number of the part of each view.
    """

    title: str
    categories: list[str]
    parts: tuple[str, ...]
    range_m: tuple[float, float]
    views: Array
    total: Array
    pixels: Array
    sizes: Array
    ranges: Array
    levels: Array
    places: list[tuple[float, float, int]] = field(default_factory=list)


def draw_statistics(figures: DatasetFigures) -> bytes:
    """How often each category is seen, how large, how far away; how bright; from where."""
    figure = Figure(figsize=(13.5, 8.0), layout="constrained")
    figure.suptitle(figure_text(figures.title), fontsize=11, color=INK)
    (seen, pixels, sizes), (ranges, levels, places) = figure.subplots(2, 3)
    shown = np.argsort(-figures.pixels, kind="stable")[:_MOST_CATEGORIES]
    names = [figure_text(figures.categories[k]) for k in shown]
    left = np.zeros(len(shown))
    for part, views in zip(figures.parts, figures.views[:, shown], strict=True):
        seen.barh(names, views, left=left, label=part)
        left += views
    seen.legend(fontsize=8)
    seen.set(xlabel="views that show it")
    pixels.barh(names, figures.pixels[shown], color=[f"C{k % 10}" for k in range(len(shown))])
    pixels.set(xlabel="pixels", xscale="log", xlim=(0.5, None))
    for axes in (seen, pixels):
        axes.invert_yaxis()
    edges = np.logspace(-6, 0, SIZES + 1)
    _lines(sizes, edges, figures.sizes[shown], names)
    sizes.set(xscale="log", xlabel="share of the image that a mask takes", ylabel="share of masks")
    slices = np.linspace(*figures.range_m, figures.ranges.shape[1] + 1)
    _lines(ranges, slices, figures.ranges[shown], names)
    ranges.set(xlabel="range, m", ylabel="share of its pixels")
    level_edges = np.linspace(0.0, 1.0, len(figures.levels) + 1)
    levels.stairs(figures.levels / max(figures.levels.sum(), 1), level_edges, fill=True, color=INK)
    levels.set(xlabel="echo intensity", ylabel="share of all pixels", yscale="log", xlim=(0, 1))
    _draw_places(places, figures)
    for axes in figure.axes:
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.2)
    return png(figure)


def _lines(axes: Axes, edges: Float64, counts: Array, names: list[str]) -> None:
    """Steps of the largest ten categories, as many as there are colours."""
    for k, (name, row) in enumerate(zip(names[:10], counts[:10], strict=True)):
        axes.stairs(row / max(row.sum(), 1), edges, color=f"C{k}", label=name, lw=1.3)
    axes.legend(fontsize=7)


def _draw_places(axes: Axes, figures: DatasetFigures) -> None:
    places = np.array(figures.places[:: len(figures.places) // _MOST_POINTS + 1]).reshape(-1, 3)
    for number, part in enumerate(figures.parts):
        x, y, _ = places[places[:, 2] == number].T
        axes.plot(x, y, ".", ms=4, color=f"C{number}", label=part)
    axes.set(xlabel="x (east), m", ylabel="y (north), m", title="where the sonar was")
    axes.title.set_fontsize(9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize=8)
