"""The layers of the page, each drawn into a viser scene under its own name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from insonify.evaluation import Solid
from insonify.frames import quaternion_from_rotation, transform_from_pose, world_from_sonar
from insonify.planning.decision import Look
from insonify.report.colours import scan_colour
from insonify.types import Array, Float32, Float64, Pose
from insonify.view import shapes
from insonify.view.cubes import Cubes
from insonify.view.story import Moment

AT_ORIGIN = Pose(0.0, 0.0, 0.0)
"""Where a sonar is drawn of which nobody says where it was."""

_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
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


def draw_cubes(scene: Any, name: str, cubes: Cubes) -> None:
    """Occupied voxels, coloured by probability."""
    if not len(cubes.index):
        scene.remove_by_name(name)
        return
    scene.add_batched_meshes_simple(
        name,
        shapes.CUBE_CORNERS * np.float32(cubes.edge_m),
        shapes.CUBE_FACES,
        batched_wxyzs=np.tile(_UPRIGHT, (len(cubes.index), 1)),
        batched_positions=cubes.centres_m,
        batched_colors=_rgb("viridis", 2.0 * cubes.value - 1.0),
        flat_shading=True,
        cast_shadow=False,
        receive_shadow=False,
        lod="off",
    )


def draw_entropy(scene: Any, undecided: Cubes) -> None:
    """Undecided voxels as dots, coloured by entropy."""
    scene.add_point_cloud(
        "/undecided/points",
        undecided.centres_m,
        _rgb("magma", 2.0 * undecided.value - 1.0),
        point_size=0.25 * undecided.edge_m,
        precision="float32",
    )


def draw_sonar(
    scene: Any, moment: Moment, picture: Array, extent: tuple[float, float, float, float]
) -> None:
    """What the sonar insonifies, and its image in the plane of the middle elevation.

    Args:
        scene: Where to.
        moment: The ping.
        picture: The image in fan view, (height, width, 4) bytes, far end on top.
        extent: What it shows: left, right, near and far, metres.
    """
    world = world_from_sonar(moment.pose or AT_ORIGIN, moment.geometry.mount)
    scene.add_frame(
        "/sonar/frame", wxyz=_wxyz(world[:3, :3]), position=world[:3, 3], axes_length=0.6,
        axes_radius=0.02,
    )  # fmt: skip
    _lines(scene, "/sonar/frame/edges", shapes.fan_edges(moment.geometry), _EDGES, 1.5)
    left, right, near, far = extent
    scene.add_image(
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


def draw_paths(scene: Any, flown: Sequence[Moment]) -> None:
    """The scans so far, each in its colour, and where the vehicle really was, if elsewhere."""
    posed = [moment for moment in flown if moment.pose is not None]
    lines, colours = [], []
    for a, b in pairwise(posed):
        assert a.pose is not None and b.pose is not None
        lines.append((a.pose.position_m, b.pose.position_m))
        colours.append(_scan_rgb(b.scan) if a.scan == b.scan else _PLANNED)
    _lines(scene, "/path/flown", np.array(lines, np.float32), np.array(colours, np.uint8), 3.0)
    true = [moment.true_pose or moment.pose or AT_ORIGIN for moment in flown]
    differs = any(moment.true_pose is not None for moment in flown)
    _lines(scene, "/path/true", shapes.path_segments(true if differs else ()), _TRUE_PATH, 1.5)


def draw_plan(scene: Any, waypoints: Sequence[Pose]) -> None:
    """The scan that was decided last."""
    _lines(scene, "/path/planned", shapes.path_segments(waypoints), _PLANNED, 1.0)


def draw_look(scene: Any, look: Look | None) -> None:
    """The candidates with what each would see of the largest cluster, and the cluster."""
    scene.remove_by_name("/candidates/all")
    scene.remove_by_name("/cluster/all")
    if look is None:
        return
    share = look.h_cluster / look.cluster.entropy
    scene.add_frame("/candidates/all", show_axes=False)
    colours = _rgb("viridis", share / max(float(share.max()), 1e-9))
    pointers = shapes.pointers(look.candidates, 1.0)
    _lines(scene, "/candidates/all/yaws", pointers, colours, 3.0)
    for k, pose in enumerate(look.candidates):
        best = " \N{BLACK STAR}" if k == look.best else ""
        scene.add_label(
            f"/candidates/all/{k}", f"{k}: {share[k]:.0%}{best}", position=pose.position_m,
            font_screen_scale=0.8,
        )  # fmt: skip
    scene.add_point_cloud(
        "/cluster/all", look.cluster.voxels_m.astype(np.float32), _CLUSTER, point_size=0.05,
        precision="float32",
    )  # fmt: skip


def _wxyz(rotation: Float64) -> Float64:
    x, y, z, w = quaternion_from_rotation(rotation)
    return np.array([w, x, y, z])


_IMAGE_WXYZ = _wxyz(transform_from_pose(Pose(0, 0, 0, 0.0, 0.0, -math.pi / 2))[:3, :3])
"""A picture's right is the sonar's starboard and its top ahead."""


def _lines(
    scene: Any, name: str, segments: Float32, colours: Array | tuple[int, int, int], width: float
) -> None:
    """Line segments (N, 2, 3) in one colour, or one (N, 3) for each."""
    if not len(segments):
        scene.remove_by_name(name)
        return
    if not isinstance(colours, tuple):
        colours = np.repeat(colours[:, None, :], 2, axis=1)
    scene.add_line_segments(name, segments, colours, thickness=width, thickness_units="screen")


def _rgb(name: str, share: Float32 | Float64) -> Array:
    """Colours (N, 3) bytes of a matplotlib colour map."""
    colours: Array = colormaps[name](np.clip(share, 0.0, 1.0), bytes=True)[:, :3]
    return np.ascontiguousarray(colours)


def _scan_rgb(number: int) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in to_rgb(scan_colour(number)))
    return red, green, blue
