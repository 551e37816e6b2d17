"""The report: one HTML file that opens offline and can be sent to a colleague."""

from __future__ import annotations

import base64
import json
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from insonify.io.configs import config_to_toml
from insonify.report import flights, pictures
from insonify.report.fans import draw_fan
from insonify.runs import Run
from insonify.types import Array, Bool, Float64


def write_report(run: Run, path: Path) -> None:
    """Write the report of a run."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("insonify", "report"), autoescape=True, trim_blocks=True
    )
    plotly = resources.files("plotly").joinpath("package_data/plotly.min.js")
    page = environment.get_template("report.html.jinja").render(
        run=run,
        result=run.result(),
        area=run.world.area,
        trajectory=_embed(pictures.draw_trajectory(run)),
        flight=_flight(run),
        decisions=[
            {"after": after, "snapshot": snapshot, "image": _embed(image)}
            for after, snapshot, image in _decisions(run)
        ],
        pings=[_embed(image) for image in _pings(run)],
        slices=_embed(pictures.draw_slices(run)),
        history=_embed(pictures.draw_history(run)),
        scene3d=json.dumps(_scene_3d(run)),
        config=config_to_toml(run.config),
        plotly=plotly.read_text(encoding="utf-8"),
    )
    path.write_text(page, encoding="utf-8")


def _flight(run: Run) -> dict[str, Any] | None:
    """The pictures of a flight, if there was one."""
    if run.flight is None or not run.flight.track.moments:
        return None
    moments = run.flight.track.moments
    return {
        "tracks": _embed(flights.draw_tracks(run, moments)),
        "errors": _embed(flights.draw_pose_errors(moments)),
    }


def _decisions(run: Run) -> list[tuple[int, Any, bytes]]:
    return [
        (after, snapshot, pictures.draw_decision(run, snapshot, after))
        for after, snapshot in enumerate(run.snapshots, 1)
        if snapshot.decision.look is not None or run.planner == "entropy"
    ]


def _pings(run: Run) -> list[bytes]:
    return [
        draw_fan(ping, f"scan {scan}, at ({pose.x_m:.1f}, {pose.y_m:.1f}) m")
        for scan, pose, ping in run.keyframes
    ]


def _scene_3d(run: Run) -> list[dict[str, Any]]:
    """Plotly traces: true positives, false positives and misses as cubes, paths, C_max."""
    truth = run.truth
    voxel_m = run.config.mapping.voxel_m
    corner = np.asarray(truth.box.low_m)
    reconstructed = run.mapper.voxels.window(truth.box).occupied & truth.scored
    actual = truth.solid & truth.scored
    kinds = (
        ("true positives", reconstructed & actual, pictures.TRUE_POSITIVE, 1.0),
        ("false positives", reconstructed & ~actual, pictures.FALSE_POSITIVE, 0.35),
        ("misses", actual & ~reconstructed, pictures.MISS, 1.0),
    )
    traces = [
        _cubes(f"{name} ({int(filled.sum())})", filled, colour, opacity, corner, voxel_m)
        for name, filled, colour, opacity in kinds
    ]
    traces += [
        _line(number, np.array([pose.position_m for pose in path.waypoints]))
        for number, path in enumerate(run.paths, 1)
    ]
    for snapshot in run.snapshots[-1:]:
        if snapshot.decision.look is not None:
            traces.append(_dots("last C_max", snapshot.decision.look.cluster.voxels_m))
    return traces


def _cubes(
    name: str, filled: Bool, colour: str, opacity: float, corner: Float64, voxel_m: float
) -> dict[str, Any]:
    vertices, faces = pictures.voxel_shell(filled, corner, voxel_m)
    points = {axis: _packed(vertices[:, i], "f4") for i, axis in enumerate("xyz")}
    corners = {axis: _packed(faces[:, i], "i4") for i, axis in enumerate("ijk")}
    return (
        points
        | corners
        | {
            "type": "mesh3d",
            "name": name,
            "color": colour,
            "opacity": opacity,
            "flatshading": True,
            "showlegend": True,
            "hoverinfo": "name",
        }
    )


def _line(number: int, positions: Float64) -> dict[str, Any]:
    points = {axis: _packed(positions[:, i], "f4") for i, axis in enumerate("xyz")}
    return points | {
        "type": "scatter3d",
        "mode": "lines+text",
        "name": f"scan {number}",
        "text": [str(number)] + [""] * (len(positions) - 1),
        "line": {"width": 5, "color": pictures.scan_colour(number)},
    }


def _dots(name: str, positions: Float64) -> dict[str, Any]:
    few = positions[:: max(1, len(positions) // 4000)]
    points = {axis: _packed(few[:, i], "f4") for i, axis in enumerate("xyz")}
    return points | {
        "type": "scatter3d",
        "mode": "markers",
        "name": name,
        "visible": "legendonly",
        "marker": {"size": 2, "color": "#4cc9f0"},
    }


def _packed(values: Array, kind: str) -> dict[str, str]:
    """An array as Plotly's typed array."""
    raw = np.ascontiguousarray(values, np.dtype(kind).newbyteorder("<")).tobytes()
    return {"dtype": kind, "bdata": base64.b64encode(raw).decode()}


def _embed(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
