from __future__ import annotations

import math

import numpy as np
import trimesh

from insonify.frames import rotation_from_rpy
from insonify.scene import Body, Scene
from insonify.scene.probes import hull_contact, ray_query
from insonify.types import Pose


def _slope() -> Scene:
    """A large plate through the origin, its normal 30 degrees off the vertical."""
    plate = trimesh.creation.box((100.0, 100.0, 0.2))
    plate.apply_translation([0.0, 0.0, -0.1])
    turn = np.eye(4)
    turn[:3, :3] = rotation_from_rpy(0.0, math.radians(30), 0.0)
    plate.apply_transform(turn)
    return Scene((Body("plate", plate),))


def test_rays_find_range_and_squareness() -> None:
    sound = ray_query(_slope())
    rays = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], np.float32)
    range_m, square = sound(np.array([0.0, 0.0, 5.0]), rays)
    np.testing.assert_allclose(range_m[0], 5.0, rtol=1e-5)
    np.testing.assert_allclose(square[0], math.cos(math.radians(30)), rtol=1e-5)
    assert math.isinf(range_m[1])


def test_a_hull_touches_within_its_radius() -> None:
    touches = hull_contact(_slope(), 0.5)
    normal = np.array([math.sin(math.radians(30)), 0.0, math.cos(math.radians(30))])
    for away, expected in ((0.45, True), (0.6, False), (-0.1, True)):
        x, y, z = (float(c) for c in away * normal)
        assert touches(Pose(x, y, z)) == expected
