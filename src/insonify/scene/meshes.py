"""Meshes from files, checked before anything is built on them."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import trimesh

from insonify.errors import MeshError, reading
from insonify.extras import optional
from insonify.frames import rotation_from_rpy
from insonify.limits import FARTHEST_M, MOST_TRIANGLES
from insonify.scene.parts import check_collada, check_gltf, local
from insonify.scene.xml import parse_xml
from insonify.types import Float64

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".gltf", ".glb", ".dae")
LARGEST_EXTENT_M = 1000.0
_AXES = {"X_UP": "x", "Y_UP": "y"}
_UPRIGHT = {
    "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "y": rotation_from_rpy(math.pi / 2, 0.0, 0.0),
}
"""Our axes from a file's: COLLADA 1.4, up_axis; to the right is -y where x is up, else x."""


def load_mesh(path: Path, scale: float = 1.0, part: str = "", up: str = "z") -> trimesh.Trimesh:
    """Read a mesh file as one body, in metres, z up.

    Args:
        path: OBJ, STL, PLY, glTF/GLB or COLLADA file; parts of a scene are merged.
        scale: Factor to metres (0.001 for a mesh in millimetres).
        up: The file's upward axis, "x", "y" or "z"; "auto": y for glTF, what COLLADA says, else z.
        part: Only the node or mesh of this name, if it is given.

    Raises:
        MeshError: The file is missing, of another kind, unreadable, empty, has vertices that are
            not finite, or is larger than 1 km after scaling.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MeshError(f"{path}: a mesh file ends in {', '.join(MESH_SUFFIXES)}")
    if not path.is_file():
        raise MeshError(f"{path}: there is no such mesh file; check the path")
    mesh, own_up = _read(path, part)
    if len(mesh.faces) == 0:
        raise MeshError(f"{path}: the mesh has no triangles; export it with its faces")
    faces = np.asarray(mesh.faces)
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        raise MeshError(
            f"{path}: a triangle names vertex {faces.max()} and there are {len(mesh.vertices)}; "
            "export the mesh again"
        )
    vertices = np.asarray(mesh.vertices, dtype=np.float64)[np.unique(faces)]
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(axis=1).sum())
        raise MeshError(f"{path}: {bad} vertices are not finite numbers; repair the mesh")
    if not np.abs(vertices).max(initial=0.0) * abs(scale) <= FARTHEST_M:
        raise MeshError(
            f"{path}: it reaches {np.abs(vertices).max():g} x {scale:g} m from its origin"
        )
    mesh = scaled(mesh, scale)
    axis = own_up if up == "auto" else up
    if axis != "z":
        turn = np.eye(4)
        turn[:3, :3] = _UPRIGHT[axis]
        mesh.apply_transform(turn)
    extent_m = float(np.max(mesh.extents))
    if extent_m > LARGEST_EXTENT_M:
        raise MeshError(
            f"{path}: the mesh is {extent_m:g} m across, more than {LARGEST_EXTENT_M:g} m; if it "
            "is not in metres, give its scale (millimetres: --set object.scale=0.001)"
        )
    if extent_m <= 0.0:
        raise MeshError(f"{path}: all vertices coincide; the mesh has no size")
    return mesh


def _read(path: Path, part: str) -> tuple[trimesh.Trimesh, str]:
    """A file's mesh, or one part of it, in the file's axes, and its upward axis."""
    suffix = path.suffix.lower()
    collada: list[ET.Element] = []
    if suffix == ".dae":
        optional("collada", "simulation", "reading COLLADA")
        root = parse_xml(path, MeshError)
        check_collada(path, root)
        collada = list(root.iter())
    elif suffix in {".gltf", ".glb"}:
        check_gltf(path)
    with reading(path, "a mesh", MeshError, Exception):  # trimesh's readers raise anything
        loaded = trimesh.load_scene(path, process=False)
        placed = _placed(path, loaded)
    wanted = {part} | _meshes_of_node(collada, part)
    to_metres = _unit_m(collada, path)
    told = _texts(collada, "up_axis") | ({"Y_UP"} if suffix in {".gltf", ".glb"} else set())
    up = next((name for axis, name in _AXES.items() if axis in told), "z")
    meshes = []
    for node, name, transform in placed:
        if not part or {node, name} & wanted:
            meshes.append(_bare(loaded.geometry[name]))
            meshes[-1].apply_transform(transform)
            meshes[-1].apply_transform(np.diag([to_metres, to_metres, to_metres, 1.0]))
    if part and not meshes:
        names = ", ".join(sorted(loaded.geometry)) or "none"
        raise MeshError(f"{path}: it has no part named {part!r}; its parts: {names}")
    return _joined(meshes), up


def _placed(path: Path, loaded: trimesh.Scene) -> list[tuple[str, str, Float64]]:
    """Node, mesh and transform of each mesh in its place.

    Raises:
        MeshError: They have too many triangles, or lie nowhere.
    """
    placed, triangles = [], 0
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        if not np.isfinite(transform).all() or np.abs(transform).max() > FARTHEST_M:
            raise MeshError(f"{path}: the place of its part {name!r:.80} makes no sense")
        placed.append((str(node), str(name), np.asarray(transform, np.float64)))
        triangles += len(mesh.faces)
    if triangles > MOST_TRIANGLES:
        raise MeshError(
            f"{path}: {triangles:,} triangles are more than {MOST_TRIANGLES:,}; use a coarser mesh"
        )
    return placed


def _bare(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh of its own without its pictures, which nobody needs and which may be huge."""
    bare = trimesh.Trimesh(mesh.vertices.copy(), mesh.faces.copy(), process=False)
    uv = getattr(mesh.visual, "uv", None)
    return bare if uv is None else _textured(bare, np.array(uv))


def _meshes_of_node(collada: list[ET.Element], name: str) -> set[str]:
    """The meshes of the node of a name in a COLLADA file: trimesh knows a part by its mesh only."""
    return {
        child.get("url", "").lstrip("#")
        for node in collada
        if local(node) == "node" and name in {node.get("name"), node.get("id")}
        for child in node.iter()
        if local(child) == "instance_geometry"
    }


def _unit_m(collada: list[ET.Element], path: Path) -> float:
    """Metres in a COLLADA file's unit; 1 for other kinds, which name none."""
    for element in collada:
        if local(element) == "unit":
            try:
                unit_m = float(element.get("meter", "1"))
            except ValueError:
                unit_m = math.nan
            if not 0.0 < unit_m <= FARTHEST_M:
                raise MeshError(f"{path}: its unit is {element.get('meter')!r:.80} metres")
            return unit_m
    return 1.0


def _texts(collada: list[ET.Element], tag: str) -> set[str]:
    return {(e.text or "").strip() for e in collada if local(e) == tag}


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Meshes as one, with texture coordinates where all of them have some."""
    if not meshes:
        return trimesh.Trimesh()
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    vertices = np.vstack([mesh.vertices for mesh in meshes])
    joined = trimesh.Trimesh(vertices, np.vstack(faces), process=False)
    uvs = [uv for mesh in meshes if (uv := getattr(mesh.visual, "uv", None)) is not None]
    return _textured(joined, np.vstack(uvs)) if len(uvs) == len(meshes) else joined


def _textured(mesh: trimesh.Trimesh, uv: Float64) -> trimesh.Trimesh:
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv)  # type: ignore[no-untyped-call]
    return mesh


def scaled(mesh: trimesh.Trimesh, scale: float) -> trimesh.Trimesh:
    """A copy with all lengths multiplied by ``scale``, without vertices that no face uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = np.asarray(mesh.vertices, np.float64)[used] * scale
    copy = trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False)
    uv = getattr(mesh.visual, "uv", None)
    return copy if uv is None else _textured(copy, np.asarray(uv)[used])


def place_mesh(
    mesh: trimesh.Trimesh, x_m: float, y_m: float, base_z_m: float, turn: Float64
) -> trimesh.Trimesh:
    """A copy turned by a rotation, its bounding box centred on (x, y) and standing on a height."""
    placed = mesh.copy()
    transform = np.eye(4)
    transform[:3, :3] = turn
    placed.apply_transform(transform)
    low, high = placed.bounds
    middle = (low + high) / 2
    placed.apply_translation([x_m - middle[0], y_m - middle[1], base_z_m - low[2]])
    return placed
