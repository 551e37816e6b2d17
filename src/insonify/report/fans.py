"""Pictures of sonar images and their truth, as PNG bytes."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from PIL import Image

from insonify.names import figure_text
from insonify.sonar.camera import Picture
from insonify.sonar.truth import Truth, label_colours
from insonify.types import Array, FanGeometry, Float32, Float64, Ping

INK, WATER, PALE = "#1d2733", "#0b1420", "#dfe7ee"
_DPI = 110


@dataclass(frozen=True, slots=True)
class Scale:
    """How an image's values are coloured, and what its colour bar says.

    Attributes:
        power: Values are shown to this power; below 1 they are shown brighter than they are.
        gamma: Where values are themselves pressure to a power, that power: the bar is in dB then.
    """

    power: float = 1.0
    gamma: float = 0.0

    @property
    def norm(self) -> Normalize:
        """From values to colours."""
        return PowerNorm(self.power, 0.0, 1.0)

    def bar(self, figure: Figure, shown: ScalarMappable, axes: Axes, ink: str = PALE) -> None:
        """Draw the colour bar beside axes."""
        bar = figure.colorbar(shown, ax=axes, shrink=0.7, pad=0.02)
        label = "echo intensity"
        if self.gamma:
            steps_db = np.arange(-80.0, 1.0, 10.0)
            values = 10.0 ** (steps_db * self.gamma / 20.0)
            told = values > 0.08
            bar.set_ticks(values[told].tolist(), labels=[f"{step:g}" for step in steps_db[told]])
            label = "level, dB under full scale"
        _pale(bar, label, ink)


AS_IT_IS = Scale()
INTENSITY = Scale(power=0.6)
"""Of the paper's images, in which sand of reflectance 1 would be all but black."""
_NARROW_RAD = 0.1
"""Half of a fan's azimuth below which three bearings would be written over each other."""
_SHADOW = (0.30, 0.20, 0.45)


def scale_of(model: str, gamma: float) -> Scale:
    """How images of an image model are shown, and a device's display gamma."""
    return Scale(gamma=gamma) if model == "physical" else INTENSITY


def bearing_text(azimuth_rad: float) -> str:
    """A bearing, positive to port, as people say it."""
    degrees = round(math.degrees(azimuth_rad), 1)
    ahead_or_astern = degrees == 0.0 or abs(degrees) == 180.0
    side = "" if ahead_or_astern else " port" if degrees > 0.0 else " stbd"
    return f"{abs(degrees):g}°{side}"


def fan_pixels(
    ping: Ping, width: int = 480, height: int | None = None
) -> tuple[Array, tuple[float, float, float, float]]:
    """A sonar image in Cartesian view: starboard to the right, range upwards.

    Args:
        ping: The image.
        width: Pixels across.
        height: Pixels upwards at most; a fan of a narrow beam has fewer across then.

    Returns:
        (height, width) float32, not a number outside the fan, first row nearest, and the extent
        (left, right, near, far) in metres.
    """
    if height is not None:
        side, near = _fan_reach(ping.geometry)
        width = min(width, max(2, int(height * 2 * side / (ping.geometry.range_max_m - near))))
    return _to_fan(ping.image, ping.geometry, width, np.nan)


def draw_fan(
    ping: Ping, title: str, width_in: float = 4.2, scale: Scale = INTENSITY, smooth: bool = False
) -> bytes:
    """A ping in fan view, with range and bearing axes and a colour bar.

    Args:
        ping: What is drawn.
        title: Above it.
        width_in: Of the picture, inches.
        scale: How values are coloured.
        smooth: Colours go over from beam to beam, as few beams would be wedges.
    """
    width = max(480, round(width_in * _DPI))
    picture, extent = _to_fan(ping.image, ping.geometry, width, np.nan, smooth)
    figure, axes = _fan_axes(ping.geometry, extent, title, width_in)
    shown = axes.imshow(picture, origin="lower", extent=extent, cmap="copper", norm=scale.norm)
    scale.bar(figure, shown, axes)
    return png(figure)


def fan_onto(axes: Axes, ping: Ping, scale: Scale, ink: str) -> AxesImage:
    """Draw a ping in fan view into axes of one's own.

    Args:
        axes: Where.
        ping: What is drawn.
        scale: How values are coloured.
        ink: Colour of the labels around it.
    """
    picture, extent = fan_pixels(ping, 800, 1600)
    fan_grid(axes, ping.geometry, extent, ink)
    return axes.imshow(picture, origin="lower", extent=extent, cmap="copper", norm=scale.norm)


def draw_polar(ping: Ping, title: str, scale: Scale = INTENSITY) -> bytes:
    """A ping as it comes: bearing across from port to starboard, range upwards."""
    geometry = ping.geometry
    half = geometry.azimuth_fov_rad / 2
    figure, axes = _dark(9.0, 6.4, title)
    extent = (half, -half, geometry.range_min_m, geometry.range_max_m)
    shown = axes.imshow(
        ping.image, origin="lower", extent=extent, aspect="auto", cmap="copper", norm=scale.norm
    )
    bearings = np.linspace(half, -half, 5)
    axes.set_xticks(bearings, [bearing_text(bearing) for bearing in bearings])
    axes.set(xlabel="azimuth", ylabel="range, m")
    scale.bar(figure, shown, axes)
    return png(figure)


def draw_truth(ping: Ping, truth: Truth, title: str, width_in: float = 9.0) -> bytes:
    """The labels of a ping's pixels in fan view; shadows dark, first returns white."""
    geometry = ping.geometry
    colours = label_colours(len(truth.labels))
    painted = np.zeros((*truth.label.shape, 3), np.float32)
    shown = truth.label >= 0
    painted[shown] = colours[truth.label[shown]] * (0.35 + 0.65 * ping.image[shown, None])
    painted[truth.shadow] = _SHADOW
    first = truth.first_return.copy()
    first[1:] |= truth.first_return[:-1]
    painted[first & shown] = 1.0
    channels, extent = [], (0.0, 0.0, 0.0, 0.0)
    for channel in range(3):
        plane, extent = _to_fan(painted[:, :, channel], geometry, round(width_in * _DPI), 0.0)
        channels.append(plane)
    figure, axes = _fan_axes(geometry, extent, title, width_in)
    axes.imshow(np.dstack(channels), origin="lower", extent=extent)
    _legend(axes, truth.labels, np.unique(truth.label[shown]), colours)
    return png(figure)


def draw_waterfall(
    image: Float32, bin_m: float, along_m: Float64, title: str, scale: Scale = INTENSITY
) -> bytes:
    """A side-scan image as towed sonars show it: port on the left, the last line on top.

    Args:
        image: (lines, 2 x bins), the last line first.
        bin_m: Slant range of a bin.
        along_m: (lines,) how far the sonar had come at each line, the first line first.
        title: Above it.
        scale: How values are coloured.
    """
    figure, axes, extent = _waterfall_axes(image.shape, bin_m, along_m, title)
    shown = axes.imshow(image, extent=extent, aspect="auto", cmap="copper", norm=scale.norm)
    scale.bar(figure, shown, axes)
    return png(figure)


def draw_waterfall_truth(
    label: Array, shadow: Array, labels: Sequence[str], bin_m: float, along_m: Float64, title: str
) -> bytes:
    """What the pixels of a side-scan image show; ``label`` and ``shadow`` are laid out as it is."""
    figure, axes, extent = _waterfall_axes(label.shape, bin_m, along_m, title)
    colours = label_colours(len(labels))
    painted = np.zeros((*label.shape, 3), np.float32)
    painted[label >= 0] = colours[label[label >= 0]]
    painted[shadow] = _SHADOW
    axes.imshow(painted, extent=extent, aspect="auto")
    _legend(axes, labels, np.unique(label[label >= 0]), colours)
    return png(figure)


def draw_soundings(points_m: Float64, title: str) -> bytes:
    """Soundings as a chart: their mean height by cells from above; of one ping, its profile."""
    figure, axes = _dark(8.0, 6.0, title)
    extent = np.ptp(points_m[:, :2], axis=0) if len(points_m) else np.zeros(2)
    if extent.min() < 0.02 * max(extent.max(), 1e-9):
        across = points_m[:, :2] @ (extent / max(float(np.linalg.norm(extent)), 1e-9))
        axes.plot(across, points_m[:, 2], ".", ms=3, color="#e8a33d")
        axes.set(xlabel="across, m", ylabel="z, m")
        return png(figure)
    cell_m = max(math.sqrt(4.0 * extent.prod() / len(points_m)), extent.max() / 400)
    edges = [np.arange(low, low + size + cell_m, cell_m) for low, size in
             zip(points_m[:, :2].min(axis=0), extent, strict=True)]  # fmt: skip
    total, _, _ = np.histogram2d(points_m[:, 0], points_m[:, 1], edges, weights=points_m[:, 2])
    count, _, _ = np.histogram2d(points_m[:, 0], points_m[:, 1], edges)
    with np.errstate(invalid="ignore"):
        shown = axes.pcolormesh(*edges, (total / count).T, cmap="viridis")
    _pale(figure.colorbar(shown, ax=axes, shrink=0.8), "mean z, m")
    axes.set_aspect("equal")
    axes.set(xlabel="x (east), m", ylabel="y (north), m")
    return png(figure)


def picture_png(picture: Picture) -> bytes:
    """A camera's picture."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="png")
    return stream.getvalue()


def _fan_reach(geometry: FanGeometry) -> tuple[float, float]:
    """How far a fan reaches to either side, and what of it lies lowest, 0 or astern; metres."""
    half = geometry.azimuth_fov_rad / 2
    side = geometry.range_max_m * (math.sin(half) if half < math.pi / 2 else 1.0)
    return side, min(0.0, geometry.range_max_m * math.cos(half))


def _to_fan(
    values: Float32, geometry: FanGeometry, width: int, outside: float, smooth: bool = False
) -> tuple[Float32, tuple[float, float, float, float]]:
    half = geometry.azimuth_fov_rad / 2
    side, near = _fan_reach(geometry)
    scale = 2 * side / width
    height = max(2, round((geometry.range_max_m - near) / scale))
    right = (np.arange(width) + 0.5) * scale - side
    ahead = near + (np.arange(height) + 0.5) * scale
    range_m = np.hypot(right, ahead[:, None])
    azimuth = np.arctan2(-right, ahead[:, None] + 0.0 * right)
    cell = np.floor((range_m - geometry.range_min_m) / geometry.bin_m).astype(int)
    beams = (half - azimuth) / geometry.beam_rad
    beam = np.floor(beams).astype(int)
    inside = (cell >= 0) & (cell < geometry.bins) & (beam >= 0) & (beam < geometry.beams)
    picture = np.full(inside.shape, outside, np.float32)
    if smooth:
        before = np.floor(beams[inside] - 0.5).astype(int)
        part = (beams[inside] - 0.5 - before).astype(np.float32)
        around = half > 0.99 * math.pi
        one, next_one = (
            k % geometry.beams if around else np.clip(k, 0, geometry.beams - 1)
            for k in (before, before + 1)
        )  # fmt: skip
        row = cell[inside]
        picture[inside] = (1.0 - part) * values[row, one] + part * values[row, next_one]
    else:
        picture[inside] = values[cell[inside], beam[inside]]
    return picture, (-side, side, near, geometry.range_max_m)


def _pale(bar: Colorbar, label: str, ink: str = PALE) -> None:
    """Label a colour bar, by default in the colours of `_dark`."""
    bar.set_label(label, fontsize=8, color=ink)
    bar.ax.tick_params(labelsize=7, colors=ink)
    bar.outline.set_edgecolor(ink)


def _dark(width_in: float, height_in: float, title: str) -> tuple[Figure, Axes]:
    """A figure in the colours of all sonar pictures: pale on dark water."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor=WATER)
    axes = figure.add_subplot(facecolor=WATER)
    axes.tick_params(colors=PALE, labelsize=8)
    for spine in axes.spines.values():
        spine.set_edgecolor(PALE)
    axes.xaxis.label.set_color(PALE)
    axes.yaxis.label.set_color(PALE)
    axes.set_title(figure_text(title), fontsize=9, color=PALE)
    return figure, axes


def _fan_axes(
    geometry: FanGeometry, extent: tuple[float, float, float, float], title: str, width_in: float
) -> tuple[Figure, Axes]:
    """Range rings and bearings around a fan, which is drawn into the axes then."""
    _, right, near, far = extent
    height_in = 0.5 + width_in * 0.9 * (far - near) / (2.4 * right)
    figure, axes = _dark(width_in, height_in, title)
    fan_grid(axes, geometry, extent)
    return figure, axes


def fan_grid(
    axes: Axes,
    geometry: FanGeometry,
    extent: tuple[float, float, float, float],
    ink: str = PALE,
) -> None:
    """Range rings and bearings of a fan, without any other axes."""
    left, right, near, far = extent
    half = geometry.azimuth_fov_rad / 2
    whole = half > 0.99 * math.pi
    angles = np.linspace(-half, half, 181)
    line = {"color": "w", "lw": 0.4, "alpha": 0.5, "zorder": 2}
    for range_m in range_ticks(far):
        axes.plot(range_m * np.sin(angles), range_m * np.cos(angles), **line)  # type: ignore[arg-type]
        x, y = (0.0, range_m) if whole else (range_m * math.sin(half), range_m * math.cos(half))
        axes.text(
            x + right * 0.03, y, f"{range_m:g} m", fontsize=7, color=ink, va="center", zorder=3
        )
    bearings = np.arange(-3, 5) * math.pi / 4 if whole else np.linspace(-half, half, 5)
    if half < 2 * _NARROW_RAD:
        bearings = bearings[::2] if half > _NARROW_RAD else bearings[2:3]
    for bearing in bearings:
        x, y = -far * math.sin(bearing), far * math.cos(bearing)
        axes.plot([0, x], [0, y], **line)  # type: ignore[arg-type]
        axes.text(
            1.02 * x, 1.02 * y, bearing_text(bearing), fontsize=7, color=ink,
            ha="left" if x > 0.1 * far else "right" if x < -0.1 * far else "center",
            va="bottom" if y > 0.0 else "top",
        )  # fmt: skip
    axes.set(
        xlim=(1.25 * left, 1.25 * right), ylim=(near * 1.12 if whole else near * 1.1, far * 1.1)
    )
    axes.set_aspect("equal")
    axes.set_axis_off()


def _waterfall_axes(
    shape: tuple[int, ...], bin_m: float, along_m: Float64, title: str
) -> tuple[Figure, Axes, tuple[float, float, float, float]]:
    """Axes of a waterfall, to scale as far as a page allows."""
    lines, reach = shape[0], shape[1] / 2 * bin_m
    length_m = float(along_m[-1] - along_m[0]) * lines / max(lines - 1, 1)
    moved = length_m > 0.0
    top = length_m if moved else float(lines)
    height = 9.0 * top / (2 * reach) if moved else 9.0 * lines / shape[1]
    figure, axes = _dark(9.0, min(max(3.0, height), 20.0), title)
    axes.set(
        xlabel="slant range, m (port left, starboard right)",
        ylabel="along track, m" if moved else "ping",
    )
    return figure, axes, (-reach, reach, 0.0, top)


def _legend(axes: Axes, labels: Sequence[str], present: Array, colours: Float32) -> None:
    keys = [Patch(color=colours[k], label=figure_text(labels[k])) for k in present[:12]]
    keys += [Patch(color=_SHADOW, label="shadow")]
    axes.legend(handles=keys, fontsize=7, loc="lower left", framealpha=0.8)


def range_ticks(range_m: float) -> Float64:
    """Round ranges for rings, at most eight."""
    step = 10 ** math.floor(math.log10(range_m))
    for divisor in (5, 2, 1):
        if range_m / (step / divisor) <= 8:
            step /= divisor
            break
    return np.arange(step, range_m, step)


def png(figure: Figure) -> bytes:
    """A figure as PNG; the same figure gives the same bytes."""
    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(
        stream, format="png", dpi=_DPI, bbox_inches="tight", facecolor=figure.get_facecolor(),
        metadata={"Software": None},
    )  # fmt: skip
    return stream.getvalue()
