"""How good a map is: ground-truth voxels, precision, recall and F (Park et al. 2025, eq. 10-12)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy import ndimage

from insonify.jit import kernel
from insonify.mapping.voxels import VoxelMap, VoxelWindow
from insonify.scene import Body, Scene
from insonify.types import Array, Bool, Box, Float64, Int32


@dataclass(frozen=True, slots=True)
class Scores:
    """Precision, recall and F-scores; a ratio of nothing to nothing counts as 0."""

    precision: float
    recall: float
    f1: float
    f2: float
    f3: float


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """The objects as voxels, over the region in which maps are scored.

    Attributes:
        box: The voxels' box; its lower corner is on the voxel grid.
        surface: (nx, ny, nz) voxels that a surface passes through.
        solid: The same with the interiors.
        scored: Voxels that count: in the box of an object, at least one voxel above the seabed.
    """

    box: Box
    surface: Bool
    solid: Bool
    scored: Bool


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A part of the true world: its name, vertices (N, 3) metres and faces (M, 3)."""

    name: str
    vertices: Array
    faces: Array


def solids_of(scene: Scene) -> tuple[Solid, ...]:
    """The bodies of a scene, and its seabed under that name."""
    return tuple(
        Solid(name, vertices, faces)
        for name, (vertices, faces) in zip(scene.labels, scene.meshes, strict=True)
    )


def ground_truth(scene: Scene, bodies: Sequence[Body], voxel_m: float) -> GroundTruth:
    """Voxels of bodies, in their bounding boxes grown by one voxel, above the seabed by one voxel.

    Args:
        scene: The world that they are in.
        bodies: One at least; where boxes overlap, what is of any of them is of an object.
        voxel_m: Edge length of a voxel.
    """
    lows = [np.floor(np.asarray(body.box.low_m) / voxel_m).astype(int) - 1 for body in bodies]
    highs = [np.floor(np.asarray(body.box.high_m) / voxel_m).astype(int) + 2 for body in bodies]
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    surface, solid, scored = np.zeros((3, *(high - low)), bool)
    for body, first, last in zip(bodies, lows, highs, strict=True):
        own = voxelise_surface(
            np.asarray(body.mesh.vertices), np.asarray(body.mesh.faces), first, last, voxel_m
        )
        box = tuple(map(slice, first - low, last - low))
        surface[box] |= own
        # what the surface shuts in, whether or not the mesh is watertight in every triangle
        solid[box] |= ndimage.binary_fill_holes(own)
        scored[box] = True
    if scene.seabed is not None:
        x, y, z = ((np.arange(a, b) + 0.5) * voxel_m for a, b in zip(low, high, strict=True))
        floor = scene.seabed.height_at(*np.meshgrid(x, y, indexing="ij"))
        scored &= z - 1.5 * voxel_m >= floor[:, :, None]
    return GroundTruth(Box.of(low * voxel_m, high * voxel_m), surface, solid, scored)


def voxelise_surface(
    vertices: Float64, faces: Int32, low: np.ndarray, high: np.ndarray, voxel_m: float
) -> Bool:
    """Voxels of a box of voxels [low, high) that a triangle mesh's surface passes through."""
    corners = np.asarray(vertices, np.float64)[faces] / voxel_m - low
    return _voxelise(np.ascontiguousarray(corners), *(int(n) for n in high - low))


@kernel
def _voxelise(triangles: Float64, nx: int, ny: int, nz: int) -> Bool:
    """Separating-axis test of each triangle (in voxel units) with the voxels of its box."""
    filled = np.zeros((nx, ny, nz), np.bool_)
    size = (nx, ny, nz)
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    for t in range(len(triangles)):
        triangle = triangles[t]
        for axis in range(3):
            low = min(triangle[0, axis], triangle[1, axis], triangle[2, axis])
            high = max(triangle[0, axis], triangle[1, axis], triangle[2, axis])
            first[axis] = max(0, math.floor(low))
            last[axis] = min(size[axis] - 1, math.floor(high))
        for ix in range(first[0], last[0] + 1):
            for iy in range(first[1], last[1] + 1):
                for iz in range(first[2], last[2] + 1):
                    if not filled[ix, iy, iz] and _touches(triangle, ix, iy, iz):
                        filled[ix, iy, iz] = True
    return filled


@kernel
def _touches(triangle: Float64, ix: int, iy: int, iz: int) -> bool:
    """Whether a triangle meets the unit cube at (ix, iy, iz) (Akenine-Moller 2001)."""
    v = np.empty((3, 3))
    for corner in range(3):
        v[corner, 0] = triangle[corner, 0] - ix - 0.5
        v[corner, 1] = triangle[corner, 1] - iy - 0.5
        v[corner, 2] = triangle[corner, 2] - iz - 0.5
    edges = np.empty((3, 3))
    for k in range(3):
        for axis in range(3):
            edges[k, axis] = v[(k + 1) % 3, axis] - v[k, axis]
    for k in range(3):  # cross products of an edge with a cube axis
        for axis in range(3):
            b, c = (axis + 1) % 3, (axis + 2) % 3
            p0 = edges[k, b] * v[0, c] - edges[k, c] * v[0, b]
            p1 = edges[k, b] * v[1, c] - edges[k, c] * v[1, b]
            p2 = edges[k, b] * v[2, c] - edges[k, c] * v[2, b]
            radius = 0.5 * (abs(edges[k, b]) + abs(edges[k, c]))
            if min(p0, p1, p2) > radius or max(p0, p1, p2) < -radius:
                return False
    normal = np.empty(3)
    radius = 0.0
    offset = 0.0
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        normal[axis] = edges[0, b] * edges[1, c] - edges[0, c] * edges[1, b]
        radius += 0.5 * abs(normal[axis])
        offset += normal[axis] * v[0, axis]
    return bool(abs(offset) <= radius)


def score_map(voxels: VoxelMap, truth: GroundTruth) -> dict[str, dict[str, dict[str, float]]]:
    """Scores of a map, by kind of truth (surface, solid) and tolerance (exact, within_one_voxel).

    The map's surface is held against the true one, and what it holds for more likely occupied than
    not against the solid.
    """
    window = voxels.window(truth.box)
    pairs = {
        "surface": (window.surface, truth.surface),
        "solid": (window.occupied, truth.solid),
    }
    return {
        kind: {
            name: asdict(compare_voxels(mapped & truth.scored, actual & truth.scored, tolerance))
            for name, tolerance in (("exact", 0), ("within_one_voxel", 1))
        }
        for kind, (mapped, actual) in pairs.items()
    }


def solid_f1(voxels: VoxelMap, truth: GroundTruth) -> float:
    """F1 of a map against the solid, voxel for voxel: of `score_map`'s figures the one alone."""
    mapped = voxels.window(truth.box).occupied & truth.scored
    return compare_voxels(mapped, truth.solid & truth.scored).f1


def ghosts(window: VoxelWindow, truth: GroundTruth, scene: Scene) -> float:
    """Voxels that a map holds for occupied where there is only water, as a share of the objects'.

    Those of a region that are outside the objects' boxes, at least a voxel above the seabed:
    scores do not see them.
    """
    centres = window.centres_m(window.occupied)
    water = in_open_water(centres, window.voxel_m, truth, scene)
    return int(np.count_nonzero(water)) / max(1, int(np.count_nonzero(truth.solid & truth.scored)))


def in_open_water(centres_m: Float64, voxel_m: float, truth: GroundTruth, scene: Scene) -> Bool:
    """Which voxels (N, 3) lie outside the objects' boxes, and above the seabed by one voxel."""
    index = np.floor((centres_m - truth.box.low_m) / voxel_m).astype(np.int64)
    within = ((index >= 0) & (index < truth.scored.shape)).all(axis=1)
    outside = np.ones(len(centres_m), bool)
    outside[within] = ~truth.scored[tuple(index[within].T)]
    if scene.seabed is None:
        return np.asarray(outside, bool)
    floor = scene.seabed.height_at(centres_m[:, 0], centres_m[:, 1])
    return np.asarray(outside & (centres_m[:, 2] - 1.5 * voxel_m >= floor), bool)


def compare_voxels(reconstructed: Bool, actual: Bool, tolerance: int = 0) -> Scores:
    """Precision, recall and F of one voxel set against another (eq. 10 to 12).

    With a tolerance, a reconstructed voxel is right if an actual one lies within so many voxels
    along each axis, and an actual voxel is found if a reconstructed one does.
    """
    near_actual, near_reconstructed = _near(actual, tolerance), _near(reconstructed, tolerance)
    precision = _ratio(reconstructed & near_actual, reconstructed)
    recall = _ratio(actual & near_reconstructed, actual)
    return Scores(precision, recall, *(f_score(precision, recall, beta) for beta in (1, 2, 3)))


def _near(voxels: Bool, tolerance: int) -> Bool:
    """Voxels within so many of one of these along each axis: a cube's dilation, axis by axis."""
    for axis in range(3 if tolerance else 0):
        ahead = np.moveaxis(voxels, axis, 0)
        voxels = voxels.copy()
        grown = np.moveaxis(voxels, axis, 0)
        for step in range(1, tolerance + 1):
            grown[step:] |= ahead[:-step]
            grown[:-step] |= ahead[step:]
    return voxels


def f_score(precision: float, recall: float, beta: float) -> float:
    """F_beta of a precision and a recall (eq. 12)."""
    below = beta * beta * precision + recall
    return (1 + beta * beta) * precision * recall / below if below > 0.0 else 0.0


def _ratio(right: Bool, of: Bool) -> float:
    total = int(np.count_nonzero(of))
    return int(np.count_nonzero(right)) / total if total else 0.0
