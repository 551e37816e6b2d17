"""The shapes of SDF that are told by figures, as meshes."""

from __future__ import annotations

from collections.abc import Callable
from xml.etree import ElementTree as ET

import numpy as np
import trimesh

from insonify.errors import WorldError
from insonify.frames import rotation_from_rpy
from insonify.scene.sdf import numbers
from insonify.types import Float64


def _positive(
    element: ET.Element, tag: str, count: int, default: list[float], where: str
) -> Float64:
    values = numbers(element.find(tag), count, default, where)
    if not (values > 0.0).all():
        raise WorldError(f"{where}: <{tag}> must be positive, not {element.findtext(tag)!r}")
    return values


def _box(element: ET.Element, where: str) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box(_positive(element, "size", 3, [1.0] * 3, where))
    return mesh


def _sphere(element: ET.Element, where: str) -> trimesh.Trimesh:
    radius_m = float(_positive(element, "radius", 1, [1.0], where)[0])
    mesh: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=radius_m)
    return mesh


def _cylinder(element: ET.Element, where: str) -> trimesh.Trimesh:
    radius_m = float(_positive(element, "radius", 1, [1.0], where)[0])
    length_m = float(_positive(element, "length", 1, [1.0], where)[0])
    mesh: trimesh.Trimesh = trimesh.creation.cylinder(radius_m, length_m, sections=96)
    return mesh


def _capsule(element: ET.Element, where: str) -> trimesh.Trimesh:
    radius_m = float(_positive(element, "radius", 1, [0.5], where)[0])
    length_m = float(_positive(element, "length", 1, [1.0], where)[0])
    mesh: trimesh.Trimesh = trimesh.creation.capsule(length_m, radius_m, count=[48, 48])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh


def _ellipsoid(element: ET.Element, where: str) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    mesh.apply_transform(np.diag([*_positive(element, "radii", 3, [1.0] * 3, where), 1.0]))
    return mesh


def _plane(element: ET.Element, where: str) -> trimesh.Trimesh:
    normal = numbers(element.find("normal"), 3, [0.0, 0.0, 1.0], where)
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        raise WorldError(f"{where}: a plane's <normal> has no direction")
    size_x, size_y = _positive(element, "size", 2, [1.0, 1.0], where) / 2
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    mesh = trimesh.Trimesh(square * [size_x, size_y, 1.0], [[0, 1, 2], [0, 2, 3]], process=False)
    turn = np.eye(4)
    x, y, z = normal / length
    turn[:3, :3] = rotation_from_rpy(0.0, 0.0, np.arctan2(y, x)) @ rotation_from_rpy(
        0.0, float(np.arccos(np.clip(z, -1.0, 1.0))), 0.0
    )
    turn[:3, :3] = turn[:3, :3] @ rotation_from_rpy(0.0, 0.0, -np.arctan2(y, x))
    mesh.apply_transform(turn)
    return mesh


SHAPES: dict[str, Callable[[ET.Element, str], trimesh.Trimesh]] = {
    "box": _box,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "capsule": _capsule,
    "ellipsoid": _ellipsoid,
    "plane": _plane,
}
"""By their element, which is read with the place it stands in, for messages."""
