"""The surface of the occupied voxels as a triangle mesh: GLB and STL.

Surface nets (Gibson 1998, doi:10.1007/BFb0056277): between an occupied voxel and one that is not
lies a square; each corner of the squares is moved to the mean of the centres of the squares that
meet in it.  The mesh is closed and keeps the voxels' volume but for rounded edges.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from insonify.errors import OutputError
from insonify.io.maps.colours import probability_colours
from insonify.io.maps.sidecar import save_origin
from insonify.mapping.voxels import VoxelMap, probability_from_log_odds
from insonify.types import Array, Float32, Float64

_BITS = 21
_UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""glTF's y axis is up, ours is z."""


def save_surface(voxels: VoxelMap, path: Path) -> None:
    """Write the surface as ``.glb`` (upright, coloured by probability) or binary ``.stl``.

    An origin is the translation of the GLB's node; an STL, of single precision, has it beside it.

    Raises:
        OutputError: No voxel is occupied, or they lie too far apart.
    """
    vertices, faces, probability = occupied_surface(voxels, path)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if path.suffix == ".stl":
        mesh.export(path, file_type="stl")
        save_origin(voxels, path)
        return
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=probability_colours(probability))
    scene = trimesh.Scene()
    placed = _UPRIGHT.copy()
    placed[:3, 3] = _UPRIGHT[:3, :3] @ voxels.origin_m
    scene.add_geometry(mesh, node_name="map", geom_name="map", transform=placed)
    path.write_bytes(bytes(scene.export(file_type="glb")))  # type: ignore[no-untyped-call]


def occupied_surface(voxels: VoxelMap, path: Path) -> tuple[Float64, Array, Float32]:
    """Vertices (N, 3) in metres, faces (M, 3) with normals outwards, probability (N,) beside them.

    Raises:
        OutputError: No voxel is occupied, or they lie too far apart.
    """
    occupied = voxels.select()
    if not len(occupied.index):
        raise OutputError(
            f"{path.name}: the map holds no occupied voxel, so that it has no surface"
        )
    order = np.lexsort(occupied.index.T[::-1])
    index, log_odds = occupied.index[order], occupied.log_odds[order]
    first = index.min(axis=0) - 1
    if (np.ptp(index, axis=0) >= (1 << _BITS) - 3).any():
        raise OutputError(
            f"{path.name}: the map is more than 2,000,000 voxels across; export a part"
        )
    squares, owner = exposed_squares(index - first)
    _, corner = np.unique(_keys(squares.reshape(-1, 3)), return_inverse=True)
    count = np.bincount(corner)
    middle = np.repeat(squares.mean(axis=1), 4, axis=0)
    vertices = np.column_stack([np.bincount(corner, middle[:, i]) / count for i in range(3)])
    probability = probability_from_log_odds(log_odds)[owner]
    beside = np.bincount(corner, np.repeat(probability, 4)) / count
    faces = corner.reshape(-1, 4)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return (vertices + first) * voxels.voxel_m, faces, beside.astype(np.float32)


def exposed_squares(index: Array) -> tuple[Array, Array]:
    """The squares between voxels of a set and others.

    Args:
        index: (N, 3) distinct voxels, from 1 to 2,000,000.

    Returns:
        Corners (M, 4, 3), anticlockwise from outside, and (M,) the voxel that each belongs to.
    """
    keys = _keys(index)
    inside = np.sort(keys)
    corners, owners = [], []
    for axis in range(3):
        u, v = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        along = 1 << _BITS * (2 - axis)
        for step in (0, 1):
            beside = keys + (2 * step - 1) * along
            place = np.minimum(np.searchsorted(inside, beside), len(inside) - 1)
            bare = np.flatnonzero(inside[place] != beside)
            around = [0 * u, u, u + v, v] if step else [0 * u, v, u + v, u]
            base = index[bare] + step * np.eye(3, dtype=np.int64)[axis]
            corners.append(base[:, None, :] + np.stack(around))
            owners.append(bare)
    return np.concatenate(corners), np.concatenate(owners)


def _keys(index: Array) -> Array:
    keys: Array = index @ np.array([1 << 2 * _BITS, 1 << _BITS, 1])
    return keys
