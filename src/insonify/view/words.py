"""What the page says beside the scene, as HTML."""

from __future__ import annotations

import base64
import html
import math

import numpy as np
from matplotlib import colormaps

from insonify.planning.decision import Decision
from insonify.types import Array
from insonify.view import shapes
from insonify.view.story import Moment, Story


def image(picture: Array, note: str) -> str:
    """A sonar image, with a word on it."""
    data = base64.b64encode(shapes.png_bytes(picture)).decode()
    return (
        f'<img alt="sonar image" src="data:image/png;base64,{data}" '
        f'style="width:100%;max-height:45vh;object-fit:contain;background:#000">{note}'
    )


def describe(story: Story, number: int) -> str:
    """A ping and the map after it."""
    count = len(story.moments)
    lines = [f"<b>{html.escape(story.title)}</b>"]
    if number:
        moment = story.moments[number - 1]
        when = f", {moment.time_s:.2f} s" if moment.time_s else ""
        scan = f", scan {moment.scan}" if story.decisions else ""
        lines += [f"ping {number} of {count}{scan}{when}", _whereabouts(moment)]
    found = story.maps.at(number)
    if found is not None:
        after, picture = found
        when = "" if after in (number, 0) else f" after ping {after}"
        lines.append(f"{picture.occupied.count:,} voxels occupied in the area{when}")
        if picture.occupied.times > 1:
            lines.append(f"merged into cubes of {picture.occupied.edge_m:g} m")
    if story.end and number == count:
        lines.append(html.escape(story.end))
    return '<div style="padding:0 1em;font-size:0.9em">' + "<br>".join(lines) + "</div>"


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
    """Why a scan was chosen: what each candidate would see."""
    text = '<div style="font-size:0.85em;padding:0 1em 0.5em">'
    if decision.look is not None:
        look = decision.look
        share = look.h_cluster / look.cluster.entropy
        rows = "".join(
            f"<tr><td>{k}{' &#9733;' if k == look.best else ''}</td><td>{look.h_sum[k]:.0f}</td>"
            f"<td>{look.h_cluster[k]:.0f}</td><td>{share[k]:.1%}</td></tr>"
            for k in range(len(look.candidates))
        )
        text += (
            f"Largest cluster: {len(look.cluster.voxels_m):,} undecided voxels, "
            f"{look.cluster.entropy:,.0f} bits. What each candidate would see:"
            '<table style="width:100%"><tr><th>candidate</th><th>H, bits</th>'
            f"<th>of cluster</th><th>share</th></tr>{rows}</table>"
        )
    if decision.stop is not None:
        text += html.escape(decision.stop.sentence)
    return text + "</div>"


def colour_bar(name: str, low: str, high: str, title: str) -> str:
    """A legend as HTML: a matplotlib colour map between two numbers."""
    stops = ", ".join(
        "rgb({},{},{})".format(*colormaps[name](share, bytes=True)[:3])
        for share in np.linspace(0, 1, 9)
    )
    return (
        f'<div style="font-size:0.8em;padding:0 1em 0.4em">{title}'
        f'<div style="height:0.7em;background:linear-gradient(90deg,{stops})"></div>'
        f'<span>{low}</span><span style="float:right">{high}</span></div>'
    )
