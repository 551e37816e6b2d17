"""Pictures of sonar images and their truth, as PNG bytes."""

from __future__ import annotations

import io
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from PIL import Image

from insonify.names import figure_text
from insonify.sonar.camera import Picture
from insonify.sonar.truth import Truth, label_colours
from insonify.types import Array, FanGeometry, Float32, Float64, Ping

INK, WATER = "#1d2733", "#0b1420"
_DPI = 110


def fan_pixels(ping: Ping, width: int = 480) -> tuple[Array, tuple[float, float, float, float]]:
    """A sonar image in Cartesian view: starboard to the right, range upwards.

    Returns:
        (height, width) float32, not a number outside the fan, first row nearest, and the extent
        (left, right, near, far) in metres.
    """
    return _to_fan(ping.image, ping.geometry, width, np.nan)


def draw_fan(ping: Ping, title: str, width_in: float = 4.2) -> bytes:
    """A ping in fan view, with range and bearing axes."""
    picture, extent = fan_pixels(ping, max(480, round(width_in * _DPI)))
    figure, axes = _fan_axes(ping.geometry, extent, title, width_in)
    axes.imshow(picture, origin="lower", extent=extent, cmap="copper", vmin=0, vmax=1)
    return png(figure)


def draw_polar(ping: Ping, title: str) -> bytes:
    """A ping as it comes: bearing across from port to starboard, range upwards."""
    geometry = ping.geometry
    half = math.degrees(geometry.azimuth_fov_rad) / 2
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.add_subplot()
    extent = (half, -half, geometry.range_min_m, geometry.range_max_m)
    picture = axes.imshow(
        ping.image, origin="lower", extent=extent, aspect="auto", cmap="copper", vmin=0, vmax=1
    )
    axes.set(xlabel="azimuth (port to starboard), degrees", ylabel="range, m")
    axes.set_title(figure_text(title), fontsize=9, color=INK)
    figure.colorbar(picture, ax=axes, label="intensity", shrink=0.8)
    return png(figure)


def draw_truth(ping: Ping, truth: Truth, title: str, width_in: float = 9.0) -> bytes:
    """The labels of a ping's pixels in fan view; shadows dark, first returns white."""
    geometry = ping.geometry
    colours = label_colours(len(truth.labels))
    painted = np.zeros((*truth.label.shape, 3), np.float32)
    shown = truth.label >= 0
    painted[shown] = colours[truth.label[shown]] * (0.35 + 0.65 * ping.image[shown, None])
    painted[truth.shadow] = (0.16, 0.12, 0.24)
    first = truth.first_return | np.roll(truth.first_return, 1, axis=0)
    painted[first & shown] = 1.0
    channels, extent = [], (0.0, 0.0, 0.0, 0.0)
    for channel in range(3):
        plane, extent = _to_fan(painted[:, :, channel], geometry, round(width_in * _DPI), 1.0)
        channels.append(plane)
    figure, axes = _fan_axes(geometry, extent, title, width_in)
    axes.imshow(np.dstack(channels), origin="lower", extent=extent)
    present = np.unique(truth.label[shown])
    keys = [Patch(color=colours[k], label=figure_text(truth.labels[k])) for k in present[:12]]
    keys += [Patch(color=(0.16, 0.12, 0.24), label="shadow")]
    axes.legend(handles=keys, fontsize=7, loc="lower left", framealpha=0.8)
    return png(figure)


def draw_waterfall(image: Float32, bin_m: float, title: str) -> bytes:
    """A side-scan image, (lines, 2 x bins), the last line on top."""
    reach = image.shape[1] / 2 * bin_m
    height = min(max(3.0, 9.0 * len(image) / image.shape[1]), 20.0)
    figure = Figure(figsize=(9.0, height), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(
        image, extent=(-reach, reach, 0, len(image)), aspect="auto", cmap="copper", vmin=0, vmax=1
    )
    axes.set(xlabel="slant range, m (port left)", ylabel="ping")
    axes.set_title(figure_text(title), fontsize=9, color=INK)
    return png(figure)


def draw_soundings(points_m: Float64, title: str) -> bytes:
    """Soundings from above, coloured by height."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    dots = axes.scatter(points_m[:, 0], points_m[:, 1], c=points_m[:, 2], s=2, cmap="viridis")
    figure.colorbar(dots, ax=axes, label="z, m")
    axes.set_aspect("equal")
    axes.set(xlabel="x (east), m", ylabel="y (north), m")
    axes.set_title(figure_text(title), fontsize=9, color=INK)
    return png(figure)


def picture_png(picture: Picture) -> bytes:
    """A camera's picture."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="png")
    return stream.getvalue()


def _to_fan(
    values: Float32, geometry: FanGeometry, width: int, outside: float
) -> tuple[Float32, tuple[float, float, float, float]]:
    half = geometry.azimuth_fov_rad / 2
    side = geometry.range_max_m * (math.sin(half) if half < math.pi / 2 else 1.0)
    near = min(0.0, geometry.range_max_m * math.cos(half))
    scale = 2 * side / width
    height = max(2, round((geometry.range_max_m - near) / scale))
    right = (np.arange(width) + 0.5) * scale - side
    ahead = near + (np.arange(height) + 0.5) * scale
    range_m = np.hypot(right, ahead[:, None])
    azimuth = np.arctan2(-right, ahead[:, None] + 0.0 * right)
    cell = np.floor((range_m - geometry.range_min_m) / geometry.bin_m).astype(int)
    beam = np.floor((half - azimuth) / geometry.beam_rad).astype(int)
    inside = (cell >= 0) & (cell < geometry.bins) & (beam >= 0) & (beam < geometry.beams)
    picture = np.full(inside.shape, outside, np.float32)
    picture[inside] = values[cell[inside], beam[inside]]
    return picture, (-side, side, near, geometry.range_max_m)


def _fan_axes(
    geometry: FanGeometry, extent: tuple[float, float, float, float], title: str, width_in: float
) -> tuple[Figure, Axes]:
    """Range rings and bearings around a fan, which is drawn into the axes then."""
    left, right, near, far = extent
    half = geometry.azimuth_fov_rad / 2
    figure = Figure(figsize=(width_in, 0.4 + width_in * 1.08 * (far - near) / (2.4 * right)))
    axes = figure.add_subplot()
    angles = np.linspace(-half, half, 181)
    line = {"color": "w", "lw": 0.4, "alpha": 0.5, "zorder": 2}
    for range_m in _ticks(far):
        axes.plot(range_m * np.sin(angles), range_m * np.cos(angles), **line)  # type: ignore[arg-type]
        axes.text(
            range_m * math.sin(half) + right * 0.03, range_m * math.cos(half), f"{range_m:g} m",
            fontsize=7, color=INK, va="center",
        )  # fmt: skip
    whole = half > 0.99 * math.pi
    bearings = np.arange(-3, 5) * math.pi / 4 if whole else np.linspace(-half, half, 5)
    for bearing in bearings:
        x, y = far * math.sin(bearing), far * math.cos(bearing)
        axes.plot([0, x], [0, y], **line)  # type: ignore[arg-type]
        label = f"{math.degrees(bearing):+.{0 if whole else 1}f}°"
        axes.text(
            1.04 * x, 1.04 * y, label, fontsize=7, color=INK, ha="center", va="center",
        )  # fmt: skip
    axes.set(
        xlim=(1.1 * left, 1.1 * right + (0.0 if whole else 0.12 * far)),
        ylim=(near * 1.1, far * 1.08),
    )
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(figure_text(title), fontsize=9, color=INK)
    return figure, axes


def _ticks(range_m: float) -> Float64:
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
    figure.savefig(stream, format="png", dpi=_DPI, bbox_inches="tight", metadata={"Software": None})
    return stream.getvalue()
