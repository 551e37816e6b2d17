from __future__ import annotations

import numpy as np
import pytest
import trimesh

from insonify.scene import Body, Material, Scene
from insonify.scene.seabed import Seabed
from insonify.types import Pose, ScanPath

FLAT = Seabed(np.full((2, 2), -10.0), 100.0, (-50.0, -50.0))


def _sphere(x: float = 0.0, z: float = 0.0, radius: float = 1.0) -> Body:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    mesh.apply_translation([x, 0.0, z])
    return Body("sphere", mesh, Material("steel", 1.0))


def test_rays_meet_what_geometry_says(rng: np.random.Generator) -> None:
    scene = Scene((_sphere(),), FLAT)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origin = np.array([-3.0, 0.5, 1.0])
    hits = scene.cast(origin, directions.astype(np.float32))
    b = directions @ origin
    root = b * b - (origin @ origin - 1.0)
    near = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
    sphere = np.where(near > 0, near, np.inf)
    with np.errstate(divide="ignore"):
        down = (-10.0 - origin[2]) / directions[:, 2]
    ground = origin + directions * down[:, None]
    on_grid = (down > 0) & (np.abs(ground[:, :2]).max(axis=1) < 49.9)
    clear = np.abs(root) > 0.02  # a polyhedron's outline differs from the sphere's
    expected = np.minimum(sphere, np.where(on_grid, down, np.inf))
    off_grid = (down > 0) & ~on_grid & ~np.isfinite(sphere)
    rows = clear & ~off_grid
    np.testing.assert_allclose(hits.range_m[rows], expected[rows], rtol=5e-3)
    assert set(hits.body[rows & np.isfinite(sphere)]) == {0}
    assert set(hits.body[rows & ~np.isfinite(sphere) & on_grid]) == {1}
    assert (hits.body[~np.isfinite(expected)] <= 1).all()


def test_far_from_the_origin_nothing_is_lost_to_single_precision() -> None:
    body = _sphere(x=500_000.0)
    scene = Scene((body,))
    hits = scene.cast(np.array([499_990.0, 0.0, 0.0]), np.array([[1, 0, 0]], np.float32))
    assert hits.range_m[0] == pytest.approx(9.0, abs=2e-3)


def _line(z: float, x0: float = -5.0, x1: float = 5.0) -> ScanPath:
    return ScanPath((Pose(x0, 0.0, z), Pose(x1, 0.0, z)))


@pytest.mark.parametrize(
    ("z", "collides"), [(0.0, True), (1.3, True), (1.7, False), (-9.7, True), (-12.0, True)]
)
def test_paths_through_bodies_and_seabed_collide(z: float, collides: bool) -> None:
    scene = Scene((_sphere(),), FLAT)
    assert (scene.first_collision(_line(z), 0.5) is not None) == collides


def test_a_pose_deep_inside_a_body_collides() -> None:
    scene = Scene((_sphere(radius=20.0),))
    assert scene.first_collision(_line(0.0, -1.0, 1.0), 0.5) is not None


def test_a_scene_of_nothing_is_a_bug() -> None:
    with pytest.raises(ValueError, match="body or a seabed"):
        Scene()
