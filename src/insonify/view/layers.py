"""The layers of the page, each drawn into a viser scene under its own name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from insonify.evaluation import Solid
from insonify.frames import quaternion_from_rotation, transform_from_pose, world_from_sonar
from insonify.planning.decision import Decision
from insonify.report.colours import scan_colour
from insonify.types import Array, Float32, Float64, Pose
from insonify.view import shapes
from insonify.view.canvas import Canvas
from insonify.view.cubes import Cubes
from insonify.view.story import Moment

AT_ORIGIN = Pose(0.0, 0.0, 0.0)
"""Where a sonar is drawn of which nobody says where it was."""

_TINTS = 32
"""Colours of a scale: a change too small to be seen is not sent."""
_PLANNED, _TRUE_PATH, _CLUSTER = (150, 150, 150), (240, 240, 240), (76, 201, 240)
_EDGES, _SEABED, _OBJECT = (255, 190, 90), (94, 84, 64), (230, 230, 235)


def light(scene: Any) -> None:
    """A light from the south and above that leaves colours what the legends say."""
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.add_light_ambient("/light/everywhere", intensity=0.7)
    scene.add_light_directional("/light/sun", intensity=1.5, position=(2.0, -3.0, 8.0))


def draw_world(scene: Any, world: Sequence[Solid]) -> None:
    """The true objects, half transparent, and the true seabed."""
    for solid in world:
        seabed = solid.name == "seabed"
        scene.add_mesh_simple(
            f"/{'seabed' if seabed else 'object'}/{solid.name}",
            np.asarray(solid.vertices, np.float32),
            np.asarray(solid.faces, np.uint32),
            color=_SEABED if seabed else _OBJECT,
            opacity=None if seabed else 0.55,
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )


def draw_cubes(canvas: Canvas, name: str, cubes: Cubes) -> None:
    """Occupied voxels, coloured by probability."""
    canvas.cubes(name, cubes, _rgb("viridis", 2.0 * cubes.value - 1.0, _TINTS))


def draw_entropy(canvas: Canvas, undecided: Cubes) -> None:
    """Undecided voxels as dots, coloured by entropy."""
    colours = _rgb("magma", 2.0 * undecided.value - 1.0, _TINTS)
    canvas.points("/undecided/points", undecided.centres_m, colours, 0.25 * undecided.edge_m)


def draw_sonar(
    canvas: Canvas, moment: Moment, picture: Array, extent: tuple[float, float, float, float]
) -> None:
    """What the sonar insonifies, and its image in the plane of the middle elevation.

    Args:
        canvas: Where to.
        moment: The ping.
        picture: The image in fan view, (height, width, 4) bytes, far end on top.
        extent: What it shows: left, right, near and far, metres.
    """
    world = world_from_sonar(moment.pose or AT_ORIGIN, moment.geometry.mount)
    canvas.scene.add_frame(
        "/sonar/frame", wxyz=_wxyz(world[:3, :3]), position=world[:3, 3], axes_length=0.6,
        axes_radius=0.02,
    )  # fmt: skip
    canvas.lines("/sonar/frame/edges", shapes.fan_edges(moment.geometry), _EDGES, 1.5)
    left, right, near, far = extent
    canvas.scene.add_image(
        "/sonar/frame/image",
        picture[::-2, ::2],  # its first row lies at the bottom there
        render_width=right - left,
        render_height=far - near,
        format="png",
        wxyz=_IMAGE_WXYZ,
        position=((near + far) / 2, 0.0, 0.0),
        cast_shadow=False,
        receive_shadow=False,
    )


def draw_paths(canvas: Canvas, flown: Sequence[Moment]) -> None:
    """The scans so far, each in its colour, and where the vehicle really was, if elsewhere."""
    posed = [(moment.pose, moment.scan) for moment in flown if moment.pose is not None]
    places = np.array([pose.position_m for pose, _ in posed], np.float32).reshape(-1, 3)
    scans = np.array([scan for _, scan in posed], np.int64)
    tints = np.array([*map(_scan_rgb, np.unique(scans).tolist()), _PLANNED], np.uint8)
    which = np.searchsorted(np.unique(scans), scans[1:])
    which[scans[1:] != scans[:-1]] = len(tints) - 1
    canvas.lines("/path/flown", np.stack([places[:-1], places[1:]], axis=1), tints[which], 3.0)
    true: list[Pose] = []
    if any(moment.true_pose is not None for moment in flown):
        true = [moment.true_pose or moment.pose or AT_ORIGIN for moment in flown]
    canvas.lines("/path/true", shapes.path_segments(true), _TRUE_PATH, 1.5)
    starts: dict[int, Pose] = {}
    for pose, scan in posed:
        starts.setdefault(scan, pose)
    canvas.labels(
        "/path/scans", [(f"scan {scan}", pose) for scan, pose in starts.items()], "bottom-center"
    )


def draw_plan(canvas: Canvas, waypoints: Sequence[Pose]) -> None:
    """The scan that was decided last."""
    canvas.lines("/path/planned", shapes.path_segments(waypoints), _PLANNED, 1.0)


def draw_decision(canvas: Canvas, decision: Decision) -> None:
    """The candidates with what each would show of the largest cluster, and the cluster.

    The one that was chosen has a star; where the scan stops, none has.
    """
    look = decision.look
    if look is None:
        for name in ("/candidates/yaws", "/candidates/shares", "/cluster/all"):
            canvas.remove(name)
        return
    share = look.h_cluster / look.cluster.entropy
    colours = _rgb("viridis", share / max(float(share.max()), 1e-9), _TINTS)
    canvas.lines("/candidates/yaws", shapes.pointers(look.candidates, 1.0), colours, 3.0)
    chosen = look.best if decision.path is not None else None
    told = [
        (f"{k}: {share[k]:.0%}{' ★' if k == chosen else ''}", pose)
        for k, pose in enumerate(look.candidates)
    ]
    canvas.labels("/candidates/shares", told, "top-left")
    canvas.points("/cluster/all", look.cluster.voxels_m.astype(np.float32), _CLUSTER, 0.05)


def _wxyz(rotation: Float64) -> Float64:
    x, y, z, w = quaternion_from_rotation(rotation)
    return np.array([w, x, y, z])


_IMAGE_WXYZ = _wxyz(transform_from_pose(Pose(0, 0, 0, 0.0, 0.0, -math.pi / 2))[:3, :3])
"""A picture's right is the sonar's starboard and its top ahead."""


def _rgb(name: str, share: Float32 | Float64, tints: int) -> Array:
    """Colours (N, 3) bytes of a matplotlib colour map, of so many different ones."""
    table = np.array([colormaps[name](k / (tints - 1), bytes=True)[:3] for k in range(tints)])
    levels = np.rint(np.asarray(share, np.float64).clip(0.0, 1.0) * (tints - 1)).astype(int)
    return np.ascontiguousarray(table[levels], np.uint8)


def _scan_rgb(number: int) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in to_rgb(scan_colour(number)))
    return red, green, blue
