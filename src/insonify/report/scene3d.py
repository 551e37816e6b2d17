"""The map against the truth in three dimensions, as Plotly's traces and layout."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from trimesh import Trimesh
from trimesh.intersections import mesh_multiplane

from insonify.mission.account import Account
from insonify.report.colours import CORRECT, FALSE_ALARM, INK, MISSED, SKY, scan_colour
from insonify.report.courses import NAMES
from insonify.report.pictures import voxel_shell
from insonify.types import Array, Bool, Float64

_CONTOURS, _MOST_SEGMENTS, _MOST_DOTS = 14, 20_000, 4000
_APART = 3
"""Waypoints between the numbers of scans that enter the area at one place."""


def traces(account: Account) -> list[dict[str, Any]]:
    """What is correct, invented and missed as cubes, the truth's outline, paths and a cluster."""
    truth = account.truth
    voxel_m = account.voxels.voxel_m
    corner = np.asarray(truth.box.low_m)
    reconstructed = account.voxels.window(truth.box).occupied & truth.scored
    actual = truth.solid & truth.scored
    kinds = (
        ("correct", reconstructed & actual, CORRECT, 1.0),
        ("false alarms", reconstructed & ~actual, FALSE_ALARM, 0.35),
        ("missed", actual & ~reconstructed, MISSED, 1.0),
    )
    drawn = [
        _cubes(f"{name} ({int(filled.sum()):,})", filled, colour, opacity, corner, voxel_m)
        for name, filled, colour, opacity in kinds
    ]
    drawn.append(_outline(account))
    drawn += [
        _line(account, number, np.array([pose.position_m for pose in path.waypoints]))
        for number, path in enumerate(account.paths, 1)
    ]
    looks = [made.decision.look for made in account.decisions if made.decision.look is not None]
    if looks:
        drawn.append(_dots("last largest cluster", looks[-1].cluster.voxels_m))
    return drawn


def layout(account: Account) -> dict[str, Any]:
    """Axes to scale, over the designated area and as high as the sonar was."""
    low = np.minimum(account.region.low_m, account.truth.box.low_m)
    high = np.maximum(account.region.high_m, account.truth.box.high_m)
    high[2] = max([high[2], *(pose.z_m for path in account.paths for pose in path.waypoints)])
    margin = 0.03 * float((high - low).max())
    size = high - low + 2 * margin
    axes = {
        f"{name}axis": {
            "title": {"text": title},
            "range": [float(low[k] - margin), float(high[k] + margin)],
        }
        for k, (name, title) in enumerate(zip("xyz", NAMES, strict=True))
    }
    across = float(size.max())
    camera = {"eye": {"x": 0.6, "y": -1.0, "z": 0.65}, "center": {"x": 0, "y": 0, "z": -0.12}}
    return {
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"},
        "modebar": {"orientation": "v"},
        "scene": axes
        | {
            "aspectmode": "manual",
            "aspectratio": {name: float(size[k]) / across for k, name in enumerate("xyz")},
            "camera": camera,
        },
    }


def _cubes(
    name: str, filled: Bool, colour: str, opacity: float, corner: Float64, voxel_m: float
) -> dict[str, Any]:
    vertices, faces = voxel_shell(filled, corner, voxel_m)
    points = {axis: _packed(vertices[:, i], "f4") for i, axis in enumerate("xyz")}
    corners = {axis: _packed(faces[:, i], "i4") for i, axis in enumerate("ijk")}
    look = {
        "type": "mesh3d", "name": name, "color": colour, "opacity": opacity, "flatshading": True,
        "showlegend": True, "hoverinfo": "name",
    }  # fmt: skip
    return points | corners | look


def _outline(account: Account) -> dict[str, Any]:
    """The true objects as contour lines, to be switched on."""
    segments = [np.zeros((0, 2, 3))]
    for solid in account.solids:
        if solid.name != "seabed":
            segments += contours(
                Trimesh(solid.vertices.astype(np.float32), solid.faces, process=False)
            )
    lines = np.concatenate(segments)
    lines = lines[:: 1 + len(lines) // _MOST_SEGMENTS]
    broken = np.full((len(lines), 3, 3), np.nan, np.float32)
    broken[:, :2] = lines
    points = {axis: _packed(broken[:, :, i].ravel(), "f4") for i, axis in enumerate("xyz")}
    return points | {
        "type": "scatter3d", "mode": "lines", "name": "true shape", "visible": "legendonly",
        "hoverinfo": "name", "line": {"width": 3, "color": INK},
    }  # fmt: skip


def contours(mesh: Trimesh) -> list[Float64]:
    """Where planes along each axis cut a mesh, as segments (N, 2, 3)."""
    found = []
    for axis, count in ((2, _CONTOURS), (0, _CONTOURS // 2), (1, _CONTOURS // 2)):
        low, high = mesh.bounds[:, axis]
        heights = low + (np.arange(count) + 0.5) / count * (high - low)
        normal = np.eye(3)[axis]
        cut: Any = mesh_multiplane
        lines, to_world, _ = cut(mesh, normal * low, normal, heights - low)
        for flat, world in zip(lines, to_world, strict=True):
            points = np.pad(flat.reshape(-1, 2), ((0, 0), (0, 1)))
            found.append((points @ world[:3, :3].T + world[:3, 3]).reshape(-1, 2, 3))
    return found


def _line(account: Account, number: int, positions: Float64) -> dict[str, Any]:
    """A scan, its number where it first is within the picture."""
    points = {axis: _packed(positions[:, i], "f4") for i, axis in enumerate("xyz")}
    low, high = np.array(account.region.low_m)[:2], np.array(account.region.high_m)[:2]
    inside = ((positions[:, :2] > low) & (positions[:, :2] < high)).all(axis=1)
    labels = [""] * len(positions)
    labels[min(int(np.argmax(inside)) + _APART * (number - 1), len(labels) - 1)] = str(number)
    return points | {
        "type": "scatter3d", "mode": "lines+text", "name": f"scan {number}", "text": labels,
        "textfont": {"size": 15, "color": scan_colour(number)}, "textposition": "top center",
        "line": {"width": 5, "color": scan_colour(number)},
    }  # fmt: skip


def _dots(name: str, positions: Float64) -> dict[str, Any]:
    few = positions[:: max(1, len(positions) // _MOST_DOTS)]
    points = {axis: _packed(few[:, i], "f4") for i, axis in enumerate("xyz")}
    return points | {
        "type": "scatter3d", "mode": "markers", "name": name, "visible": "legendonly",
        "marker": {"size": 2, "color": SKY},
    }  # fmt: skip


def _packed(values: Array, kind: str) -> dict[str, str]:
    """An array as Plotly's typed array."""
    raw = np.ascontiguousarray(values, np.dtype(kind).newbyteorder("<")).tobytes()
    return {"dtype": kind, "bdata": base64.b64encode(raw).decode()}
