"""Procedural objects, as watertight meshes: the two of Park et al. 2025, Table 1, and six more."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import trimesh

from insonify.extras import optional
from insonify.frames import rotation_from_rpy
from insonify.types import Float64

TETRAPOD_SIZE_M = (4.1, 3.7, 3.3)
WRECK_SIZE_M = (6.3, 11.4, 6.9)


def tetrapod() -> trimesh.Trimesh:
    """A breakwater tetrapod: four tapered legs, one up, joined at a core; z up, on z = 0."""
    core = _manifold().sphere(0.62, 48)
    leg = _manifold().cylinder(2.0, 0.66, 0.40, 40)
    down = math.acos(-1.0 / 3.0)  # angle between two legs of a regular tetrahedron
    solid = core + leg
    for k in range(3):
        turn = rotation_from_rpy(0.0, down, 2.0 * math.pi * k / 3.0)
        solid += leg.transform(np.hstack([turn, np.zeros((3, 1))]))
    return _mesh(solid, TETRAPOD_SIZE_M)


def shipwreck() -> trimesh.Trimesh:
    """A small coaster's wreck: hull with an open hold, deckhouse, funnel and mast, with a list.

    The bow points along +y.  The list and trim are part of the shape, so that the bounding box
    is the paper's; burying it is the scene's business.
    """
    hull = _hull(length_m=11.0, beam_m=4.6, depth_m=3.0)
    hold = _hull(length_m=6.8, beam_m=4.2, depth_m=3.0).translate([0.0, 0.5, 0.3])
    deckhouse = _box((2.6, 2.0, 1.9), (0.0, -3.6, 2.9))
    bridge = _box((3.2, 1.1, 0.9), (0.0, -3.3, 4.7))
    funnel = _manifold().cylinder(1.3, 0.4, 0.34, 24).translate([0.0, -4.3, 4.6])
    mast = _manifold().cylinder(4.3, 0.16, 0.10, 16).translate([0.0, 3.9, 2.7])
    boom = _manifold().cylinder(2.6, 0.09, 0.09, 12).rotate([-58.0, 0.0, 0.0])
    ship = (hull - hold) + deckhouse + bridge + funnel + mast + boom.translate([0.0, 3.9, 3.3])
    return _mesh(ship.rotate([4.0, 17.0, 0.0]), WRECK_SIZE_M)


def pipe() -> trimesh.Trimesh:
    """A closed pipe of 5 m along x on two supports, with water under it."""
    solid = _manifold().cylinder(5.0, 0.3, 0.3, 48).rotate([0.0, 90.0, 0.0])
    solid = solid.translate([-2.5, 0.0, 0.9])
    for x in (-1.6, 1.6):
        solid += _box((0.3, 0.9, 0.9), (x, 0.0, 0.0))
    return _mesh(solid)


def arch() -> trimesh.Trimesh:
    """Two pillars under a slab of 4 m along x that juts out beyond them."""
    solid = _box((4.0, 1.2, 0.5), (0.0, 0.0, 1.8))
    for x in (-1.3, 1.3):
        solid += _box((0.6, 0.8, 1.9), (x, 0.0, 0.0))
    return _mesh(solid)


def amphorae() -> trimesh.Trimesh:
    """A heap of eleven amphorae, as they lie when their ship has gone: three layers."""
    jar = _amphora()
    solid = _manifold()()
    places = [
        *((0.45 * i - 0.9, -0.55, 0.18, 0.0) for i in range(5)),
        *((0.45 * i - 0.65, 0.5, 0.18, 180.0) for i in range(4)),
        (-0.4, 0.05, 0.52, 70.0),
        (0.45, -0.1, 0.55, -40.0),
    ]
    for number, (x, y, z, turn) in enumerate(places):
        lying = jar.rotate([90.0, 0.0, turn + 9.0 * math.sin(2.4 * number)])
        solid += lying.translate([x, y, z])
    return _mesh(solid)


def boxes() -> trimesh.Trimesh:
    """Three boxes that stand together and one across the top, each at an angle of its own."""
    solid = _box((1.4, 1.0, 1.0), (0.0, 0.0, 0.0))
    solid += (
        _box((1.0, 0.8, 0.7), (0.0, 0.0, 0.0)).rotate([0.0, 0.0, 25.0]).translate([1.1, 0.3, 0])
    )
    solid += (
        _box((0.9, 1.2, 0.8), (0.0, 0.0, 0.0)).rotate([0.0, 0.0, -15.0]).translate([-1, -0.2, 0])
    )
    solid += _box((1.0, 0.6, 0.5), (0.0, 0.0, 0.95)).rotate([0.0, 0.0, 40.0])
    return _mesh(solid)


def trap() -> trimesh.Trimesh:
    """A fisher's trap of 2.4 x 1.6 x 1.2 m: bars of 8 cm with openings of 0.4 m between them."""
    size_m, bar_m, pitch_m = (2.4, 1.6, 1.2), 0.08, 0.4
    solid = _manifold()()
    for axis in range(3):
        across = [k for k in range(3) if k != axis]
        first, second = (
            np.arange(0.0, size_m[k] + 1e-6, pitch_m).round(6).tolist() for k in across
        )
        for a in first:
            for b in second:
                inner = (0.0 < a < size_m[across[0]] - 1e-6, 0.0 < b < size_m[across[1]] - 1e-6)
                if all(inner):
                    continue
                extent, place = [0.0] * 3, [0.0] * 3
                extent[axis], place[axis] = size_m[axis] + bar_m, size_m[axis] / 2
                extent[across[0]] = extent[across[1]] = bar_m
                place[across[0]], place[across[1]] = a, b
                solid += _manifold().cube(extent, True).translate(place)
    return _mesh(solid)


def tower() -> trimesh.Trimesh:
    """A tower of 3.6 m on a foot, with a drum on its top that juts out."""
    solid = _box((1.6, 1.6, 0.4), (0.0, 0.0, 0.0))
    solid += _manifold().cylinder(2.8, 0.4, 0.3, 40).translate([0.0, 0.0, 0.3])
    solid += _manifold().cylinder(0.6, 0.7, 0.7, 48).translate([0.0, 0.0, 3.0])
    return _mesh(solid)


PROCEDURAL_OBJECTS = {
    "tetrapod": tetrapod,
    "shipwreck": shipwreck,
    "pipe": pipe,
    "arch": arch,
    "amphorae": amphorae,
    "boxes": boxes,
    "trap": trap,
    "tower": tower,
}


def _amphora() -> Any:
    """A jar of 1 m, standing on its spike."""
    profile_m = ((0.02, 0.0), (0.05, 0.1), (0.17, 0.35), (0.18, 0.6), (0.07, 0.75), (0.08, 1.0))
    ring = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    solid = _manifold()()
    for (r0, z0), (r1, z1) in pairwise(profile_m):
        solid += _manifold().hull_points(
            np.array(
                [
                    (r * math.cos(a), r * math.sin(a), z)
                    for r, z in ((r0, z0), (r1, z1))
                    for a in ring
                ]
            )
        )
    return solid


def _manifold() -> Any:
    """Manifold's class of solids, which can be added and subtracted."""
    return optional("manifold3d", "simulation", "making objects").Manifold


def _hull(length_m: float, beam_m: float, depth_m: float) -> Any:
    """A solid hull, deck up, keel on z = 0, as the convex hull of its frames."""
    points = []
    for t in np.linspace(-1.0, 1.0, 25):
        taper = max(0.04, 1.0 - max(0.0, t) ** 2.4 - 0.35 * max(0.0, -t) ** 3)
        sheer = 0.35 * t * t * (1.0 if t > 0 else 0.4)
        y = t * length_m / 2
        half = beam_m / 2 * taper
        keel = 0.45 * depth_m * max(0.0, t) ** 4
        points += [(side * half, y, depth_m + sheer) for side in (-1.0, 1.0)]
        points += [(side * half * 0.92, y * 0.97, 0.45 * depth_m + keel / 2) for side in (-1.0, 1)]
        points += [(side * half * 0.45, y * 0.90, keel) for side in (-1.0, 1.0)]
    return _manifold().hull_points(np.asarray(points))


def _box(size_m: tuple[float, float, float], base_m: tuple[float, float, float]) -> Any:
    """A box standing on ``base_m``, the middle of its lower face."""
    return (
        _manifold().cube(size_m, True).translate([base_m[0], base_m[1], base_m[2] + size_m[2] / 2])
    )


def _mesh(solid: Any, size_m: tuple[float, float, float] | None = None) -> trimesh.Trimesh:
    """As a mesh over the origin, its base on z = 0, stretched to a box if one is given."""
    raw = solid.to_mesh64()
    vertices: Float64 = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low if size_m is None else np.asarray(size_m)
    vertices = (vertices - low) * (size / (high - low))
    vertices -= np.array([size[0] / 2, size[1] / 2, 0.0])
    return trimesh.Trimesh(vertices=vertices, faces=np.asarray(raw.tri_verts), process=False)
