"""The surface mesh against the voxels' volume, closed, upright, outside outwards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from insonify.io.maps import save_map
from insonify.io.maps.surface import exposed_squares, occupied_surface
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.scene.meshes import load_mesh
from insonify.types import Box

MakeMap = Callable[..., VoxelMap]


def _ball(voxel_m: float = 0.1, radius_m: float = 1.0) -> VoxelMap:
    voxels = VoxelMap(voxel_m)
    reach = int(np.ceil(radius_m / voxels.block_m)) + 1
    grid = np.stack(np.meshgrid(*[np.arange(-reach, reach)] * 3), axis=-1).reshape(-1, 3)
    voxels.allocate(grid.astype(np.int32))
    window = voxels.window(Box((-9.0,) * 3, (9.0,) * 3))
    for slot, block in enumerate(voxels.coords):
        within = np.stack(np.unravel_index(np.arange(512), (8, 8, 8)), axis=-1)
        centre = (block * 8 + within + 0.5) * voxel_m - (0.3, 0.0, 2 * voxel_m)
        voxels.log_odds[slot] = np.where((centre**2).sum(axis=1) < radius_m**2, 2.0, -2.0)
    voxels.seen[:] = IN_VIEW | OBSERVED
    assert window.voxel_m == voxel_m
    return voxels


def test_a_balls_surface_is_closed_round_and_where_the_ball_is(tmp_path: Path) -> None:
    voxels = _ball()
    save_map(voxels, tmp_path / "m.stl")
    mesh = trimesh.load_mesh(tmp_path / "m.stl")
    assert mesh.is_watertight and mesh.euler_number == 2
    assert mesh.volume == pytest.approx(4 / 3 * np.pi, rel=0.03)
    centre = np.array([0.3, 0.0, 0.2])
    np.testing.assert_allclose(mesh.center_mass, centre, atol=0.01)
    radii = np.linalg.norm(mesh.vertices - centre, axis=1)
    assert abs(radii - 1.0).max() < 0.1
    # the plain shell of cubes is farther off and larger
    assert mesh.area < 1.25 * 4 * np.pi


def test_a_glb_stands_upright_and_is_coloured_by_probability(tmp_path: Path) -> None:
    voxels = _ball()
    voxels.log_odds[voxels.coords[:, 0] >= 0] *= 0.1
    save_map(voxels, tmp_path / "m.glb")
    ours = load_mesh(tmp_path / "m.glb", up="auto")  # reads glTF as y up
    np.testing.assert_allclose(ours.bounds.mean(axis=0), (0.3, 0.0, 0.2), atol=0.06)
    theirs = trimesh.load_scene(tmp_path / "m.glb").geometry["map"]
    colours = theirs.visual.vertex_colors
    left, right = theirs.vertices[:, 0] < -0.2, theirs.vertices[:, 0] > 0.2
    assert len(np.unique(colours[left], axis=0)) == len(np.unique(colours[right], axis=0)) == 1
    assert (colours[left][0] != colours[right][0]).any()


def test_random_surfaces_are_closed_and_keep_the_volume(make_map: MakeMap, tmp_path: Path) -> None:
    for seed in range(5):
        voxels = make_map(seed, reach=3)
        vertices, faces, probability = occupied_surface(voxels, tmp_path / "m.stl")
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()
        assert (probability > 0.5).all() and len(probability) == len(vertices)
        assert abs(vertices).max() < 8 * 0.1 * 5


def test_squares_look_outwards_and_enclose_the_voxels(rng: np.random.Generator) -> None:
    filled = rng.random((5, 6, 7)) < 0.4
    squares, owner = exposed_squares(np.argwhere(filled) + 1)
    normal = np.cross(squares[:, 1] - squares[:, 0], squares[:, 2] - squares[:, 0])
    volume = (squares.mean(axis=1) * normal).sum() / 3
    assert volume == pytest.approx(filled.sum())
    middle = np.argwhere(filled)[owner] + 1.5
    np.testing.assert_allclose(squares.mean(axis=1) - middle, normal / 2)
