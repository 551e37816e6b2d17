"""Procedural objects, as watertight meshes of the sizes in Park et al. 2025, Table 1."""

from __future__ import annotations

import math
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
    return _fit(solid, TETRAPOD_SIZE_M)


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
    return _fit(ship.rotate([4.0, 17.0, 0.0]), WRECK_SIZE_M)


PROCEDURAL_OBJECTS = {"tetrapod": tetrapod, "shipwreck": shipwreck}


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


def _fit(solid: Any, size_m: tuple[float, float, float]) -> trimesh.Trimesh:
    """As a mesh scaled to the bounding box ``size_m``, its base on z = 0."""
    raw = solid.to_mesh64()
    vertices: Float64 = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - low) * (np.asarray(size_m) / (high - low))
    vertices -= np.array([size_m[0] / 2, size_m[1] / 2, 0.0])
    return trimesh.Trimesh(vertices=vertices, faces=np.asarray(raw.tri_verts), process=False)
