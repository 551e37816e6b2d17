"""What the page says beside the scene, as HTML."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterator

import numpy as np
from matplotlib import colormaps

from insonify.planning.decision import Decision
from insonify.report.fans import bearing_text, range_ticks
from insonify.types import Array, FanGeometry
from insonify.view import shapes
from insonify.view.story import Moment, Story

KEYS = "Keys: ← and → step, space plays."
_ARC, _BEARINGS = 48, 5
_LETTERS = 28
"""Of the axes, in pixels of a picture 560 wide."""


def waiting(name: str) -> str:
    """Before there is anything to show."""
    return _block(f"<b>{html.escape(name)}</b><br>being opened...")


def image(
    picture: Array, geometry: FanGeometry, extent: tuple[float, float, float, float], note: str
) -> str:
    """A sonar image with range rings and bearings, and a word on it.

    Args:
        picture: RGBA bytes (height, width, 4), the far end on top.
        geometry: The fan that it shows.
        extent: Its left, right, near and far edge, metres.
        note: Below it, HTML.
    """
    data = base64.b64encode(shapes.png_bytes(picture)).decode()
    height, width = picture.shape[:2]
    margin, top = 3 * _LETTERS, 1.9 * _LETTERS
    box = f"{-margin} {-top} {width + 2 * margin} {height + top + 0.8 * _LETTERS}"
    axes = "".join(_axes(geometry, extent, width / (extent[1] - extent[0])))
    return (
        f'<svg role="img" aria-label="sonar image" data-image="ping" viewBox="{box}" '
        'style="display:block;width:100%;max-height:40vh;background:#000">'
        f'<image href="data:image/png;base64,{data}" width="{width}" height="{height}"/>'
        '<g fill="none" stroke="#dfe7ee" stroke-opacity="0.35" stroke-width="1.5" '
        f'font-size="{_LETTERS}" font-family="system-ui, sans-serif">{axes}</g></svg>'
        + _block(f"range in metres; port is left{note}", "0.75em")
    )


def _axes(
    geometry: FanGeometry, extent: tuple[float, float, float, float], per_m: float
) -> Iterator[str]:
    """Rings and rays of a fan in a picture's pixels, as SVG."""
    left, _, _, far = extent
    half = geometry.azimuth_fov_rad / 2
    whole = half > 0.99 * math.pi

    def place(range_m: float, azimuth_rad: float) -> tuple[float, float]:
        x_m, y_m = -range_m * math.sin(azimuth_rad), range_m * math.cos(azimuth_rad)
        return (x_m - left) * per_m, (far - y_m) * per_m

    for range_m in [*range_ticks(far), far]:
        ring = [place(range_m, azimuth) for azimuth in np.linspace(-half, half, _ARC + 1)]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in ring)
        yield f'<polyline points="{points}"/>'
        if range_m < 0.93 * far:
            x, y = place(range_m, 0.0 if whole else -half)
            yield _letters(f"{range_m:g}", x + 8, y + 8, "start")
    bearings = np.arange(-3, 5) * math.pi / 4 if whole else np.linspace(-half, half, _BEARINGS)
    for azimuth in bearings:
        (x0, y0), (x1, y1) = place(geometry.range_min_m, azimuth), place(far, azimuth)
        yield f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"/>'
        x, y = place(far + 0.5 * _LETTERS / per_m, azimuth)
        side = "start" if azimuth < -0.2 else "end" if azimuth > 0.2 else "middle"
        if whole or azimuth in (bearings[0], bearings[_BEARINGS // 2], bearings[-1]):
            yield _letters(bearing_text(float(azimuth)), x, y, "middle" if not whole else side)


def _letters(text: str, x: float, y: float, anchor: str) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="#dfe7ee" stroke="#000" '
        f'stroke-opacity="0.8" stroke-width="4" paint-order="stroke">{text}</text>'
    )


def describe(story: Story, number: int) -> str:
    """A ping and the map after it."""
    count = len(story.moments)
    ping = story.ping_of(number)
    lines = [f"<b>{html.escape(story.title)}</b>"]
    if number:
        moment = story.moments[number - 1]
        when = f", {moment.time_s:.2f} s" if moment.time_s else ""
        scan = f", scan {moment.scan}" if story.decisions else ""
        lines += [f"ping {ping} of {story.pings}{scan}{when}", _whereabouts(moment)]
    found = story.maps.at(number)
    if found is not None:
        after, picture = found
        after = story.ping_of(after)
        when = "" if after in (ping, 0) else f" after ping {after}"
        lines.append(f"{picture.occupied.count:,} voxels occupied in the area{when}")
        if picture.occupied.times > 1:
            lines.append(f"merged into cubes of {picture.occupied.edge_m:g} m")
    if story.end and number == count:
        lines.append(html.escape(story.end))
    if count > 1:
        lines.append(f'<span style="opacity:0.6">{KEYS}</span>')
    return _block("<br>".join(lines), "0.9em")


def _whereabouts(moment: Moment) -> str:
    if moment.pose is None:
        return "no pose: drawn at the origin"
    x, y, z = moment.pose.position_m
    text = f"at ({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {math.degrees(moment.pose.yaw_rad):.1f}°"
    if moment.true_pose is not None:
        off = math.dist(moment.pose.position_m, moment.true_pose.position_m)
        text += f"<br>{off:.2f} m from where it really was"
    return text


def reasons(decision: Decision) -> str:
    """Why a scan was chosen, or none: what each candidate would show."""
    text = ""
    if decision.why_not is not None:
        text += f"<p><b>Stop.</b> {html.escape(decision.why_not)}</p>"
    if decision.look is not None:
        look = decision.look
        share = look.h_cluster / look.cluster.entropy
        chosen = look.best if decision.path is not None else None
        rows = "".join(
            f"<tr><td>{k}{' &#9733;' if k == chosen else ''}</td><td>{share[k]:.1%}</td>"
            f"<td>{look.h_cluster[k]:.0f}</td><td>{look.h_sum[k]:.0f}</td></tr>"
            for k in range(len(look.candidates))
        )
        text += (
            f"Largest cluster: {len(look.cluster.voxels_m):,} undecided voxels, "
            f"{look.cluster.entropy:,.0f} bits. A scan is flown for more than "
            f"{look.termination:.3g} of it. What each candidate would show:"
            '<table style="width:100%;text-align:right"><tr><th>candidate</th><th>share</th>'
            f"<th>bits of it</th><th>bits in all</th></tr>{rows}</table>"
        )
    return _block(text, "0.85em")


def legends() -> str:
    """The colours of voxels, side by side."""
    return (
        '<div style="display:flex;gap:1em;padding:0 1em">'
        + _colour_bar("viridis", "0.5", "1", "occupied: probability")
        + _colour_bar("magma", "0.5", "1", "undecided: entropy, bits")
        + "</div>"
    )


def _colour_bar(name: str, low: str, high: str, title: str) -> str:
    """A legend: a matplotlib colour map between two numbers."""
    stops = ", ".join(
        "rgb({},{},{})".format(*colormaps[name](share, bytes=True)[:3])
        for share in np.linspace(0, 1, 9)
    )
    return (
        f'<div data-legend="{name}" style="flex:1;font-size:0.75em;line-height:1.3">{title}'
        f'<div style="height:0.7em;background:linear-gradient(90deg,{stops})"></div>'
        f'<span>{low}</span><span style="float:right">{high}</span></div>'
    )


def _block(text: str, size: str = "0.9em") -> str:
    return f'<div style="padding:0.2em 1em;font-size:{size};line-height:1.4">{text}</div>'
