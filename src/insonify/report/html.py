"""The report: one HTML file that opens offline and can be sent to a colleague."""

from __future__ import annotations

import base64
import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from insonify.mission.account import Account
from insonify.planning.decision import DecisionRecord
from insonify.report import flights, pictures
from insonify.report.fans import draw_fan, scale_of
from insonify.types import Array, Bool, Float64


def write_report(account: Account, path: Path) -> None:
    """Write the report of a scan, of its run or of its files.

    Raises:
        MissingExtraError: The packages for reports are not installed.
    """
    plotly = resources.files("plotly").joinpath("package_data/plotly.min.js")
    page = template("report.html.jinja").render(
        account=account,
        result=account.result,
        trajectory=embed(pictures.draw_trajectory(account)),
        flight=_flight(account),
        decisions=[
            {"after": after, "decision": record.decision, "image": embed(image)}
            for after, record, image in _decisions(account)
        ],
        pings=[embed(image) for image in _pings(account)],
        slices=embed(pictures.draw_slices(account)),
        history=embed(pictures.draw_history(account.result)),
        scene3d=json.dumps(_scene_3d(account)),
        config=account.config_toml,
        plotly=plotly.read_text(encoding="utf-8"),
    )
    path.write_text(page, encoding="utf-8")


def template(name: str) -> jinja2.Template:
    """A template of this room."""
    loader = jinja2.PackageLoader("insonify", "report")
    return jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True).get_template(name)


def embed(png: bytes) -> str:
    """A picture as an address that holds it."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _flight(account: Account) -> dict[str, Any] | None:
    """The pictures of a flight, if there was one."""
    if not account.moments:
        return None
    moments = list(account.moments)
    return {
        "tracks": embed(flights.draw_tracks(account, moments)),
        "errors": embed(flights.draw_pose_errors(moments)),
    }


def _decisions(account: Account) -> list[tuple[int, DecisionRecord, bytes]]:
    """Those made on a map, if their reasons are known or they are the entropy planner's."""
    made = [record for record in account.decisions if record.entropy_bits is not None]
    return [
        (after, record, pictures.draw_decision(account, record, after))
        for after, record in enumerate(made, 1)
        if record.decision.look is not None or account.result.planner == "entropy"
    ]


def _pings(account: Account) -> list[bytes]:
    config = tomllib.loads(account.config_toml)
    scale = scale_of(config["model"], config["sonar"]["display_gamma"])
    found = []
    for scan, posed in account.keyframes:
        assert posed.pose is not None
        where = f"at ({posed.pose.x_m:.1f}, {posed.pose.y_m:.1f}) m"
        found.append(draw_fan(posed.ping, f"scan {scan}, {where}", scale=scale))
    return found


def _scene_3d(account: Account) -> list[dict[str, Any]]:
    """Plotly traces: true positives, false positives and misses as cubes, paths, C_max."""
    truth = account.truth
    voxel_m = account.voxels.voxel_m
    corner = np.asarray(truth.box.low_m)
    reconstructed = account.voxels.window(truth.box).occupied & truth.scored
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
        for number, path in enumerate(account.paths, 1)
    ]
    for record in account.decisions[-1:]:
        if record.decision.look is not None:
            traces.append(_dots("last C_max", record.decision.look.cluster.voxels_m))
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
