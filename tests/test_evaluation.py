from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import fbeta_score, precision_score, recall_score

from insonify.evaluation import (
    compare_voxels,
    f_score,
    ghosts,
    ground_truth,
    score_map,
    voxelise_surface,
)
from insonify.frames import rotation_from_rpy
from insonify.mapping.voxels import VoxelMap
from insonify.scene import Body, Material, Scene
from insonify.scene.meshes import place_mesh
from insonify.scene.objects import tetrapod
from insonify.scene.seabed import Seabed
from insonify.types import Box


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_equations_10_to_12_agree_with_scikit_learn(seed: int, a: float, b: float) -> None:
    rng = np.random.default_rng(seed)
    reconstructed, actual = rng.random((5, 6, 7)) < a, rng.random((5, 6, 7)) < b
    scores = compare_voxels(reconstructed, actual)
    y, x = actual.ravel(), reconstructed.ravel()
    assert scores.precision == pytest.approx(precision_score(y, x, zero_division=0))
    assert scores.recall == pytest.approx(recall_score(y, x, zero_division=0))
    for beta, found in ((1, scores.f1), (2, scores.f2), (3, scores.f3)):
        assert found == pytest.approx(fbeta_score(y, x, beta=beta, zero_division=0))


def test_the_papers_own_f_scores_follow_from_its_precision_and_recall() -> None:
    for p, r, f1, f2, f3 in [
        (0.249, 0.587, 0.350, 0.462, 0.518),
        (0.390, 0.811, 0.527, 0.667, 0.732),
        (0.316, 0.701, 0.436, 0.564, 0.625),
    ]:
        assert [f_score(p, r, beta) for beta in (1, 2, 3)] == pytest.approx([f1, f2, f3], abs=2e-3)


def test_within_one_voxel_forgives_one_voxel_and_not_two() -> None:
    actual = np.zeros((7, 7, 7), bool)
    actual[3, 3, 3] = True
    for shift, right in ((1, 1.0), (2, 0.0)):
        moved = np.roll(actual, shift, 0)
        near = compare_voxels(moved, actual, tolerance=1)
        assert (near.precision, near.recall, near.f1) == (right, right, right)
        assert compare_voxels(moved, actual).f1 == 0.0


def test_surface_voxels_hold_every_point_of_the_surface() -> None:
    mesh = tetrapod()
    mesh.apply_translation([0.033, -0.021, 0.057])
    low, high = np.array([-25, -25, -2]), np.array([25, 25, 40])
    surface = voxelise_surface(np.asarray(mesh.vertices), np.asarray(mesh.faces), low, high, 0.1)
    points = trimesh.sample.sample_surface(mesh, 60_000, seed=1)[0]
    index = np.floor(points / 0.1).astype(int) - low
    assert surface[tuple(index.T)].all()
    centres = (np.argwhere(surface) + low + 0.5) * 0.1
    nearest = trimesh.proximity.closest_point_naive(mesh, centres[::40])  # type: ignore[no-untyped-call]
    distance = nearest[1]
    assert distance.max() <= 0.05 * np.sqrt(3) + 1e-9


def _scene(burial_m: float = 0.3) -> tuple[Scene, Body]:
    seabed = Seabed(np.zeros((2, 2)), 100.0, (-50.0, -50.0))
    body = Body(
        "tetrapod",
        place_mesh(tetrapod(), 0, 0, -burial_m, rotation_from_rpy(0, 0, 0.4)),
        Material("c", 1.0),
    )
    return Scene((body,), seabed), body


def test_solid_truth_is_the_surface_and_what_trimesh_finds_inside() -> None:
    scene, body = _scene()
    truth = ground_truth(scene, (body,), 0.1)
    index = np.argwhere(np.ones(truth.solid.shape, bool))
    centres = (index + 0.5) * 0.1 + truth.box.low_m
    inside = body.mesh.contains(centres).reshape(truth.solid.shape)
    np.testing.assert_array_equal(truth.solid, truth.surface | inside)


def test_region_is_the_box_grown_by_one_voxel_above_the_seabed_by_one() -> None:
    scene, body = _scene()
    truth = ground_truth(scene, (body,), 0.1)
    low, high = np.array(body.box.low_m), np.array(body.box.high_m)
    assert ((low - truth.box.low_m >= 0.1) & (low - truth.box.low_m < 0.2 + 1e-9)).all()
    assert ((truth.box.high_m - high >= 0.1) & (truth.box.high_m - high < 0.2 + 1e-9)).all()
    bottoms = truth.box.low_m[2] + np.arange(truth.scored.shape[2]) * 0.1
    np.testing.assert_array_equal(truth.scored[3, 3], bottoms >= 0.1 - 1e-9)


def test_a_perfect_map_scores_one_and_an_empty_map_nothing() -> None:
    scene, body = _scene()
    truth = ground_truth(scene, (body,), 0.1)
    voxels = VoxelMap(0.1)
    assert score_map(voxels, truth)["solid"]["exact"]["f1"] == 0.0
    index = np.argwhere(truth.solid) + np.round(np.array(truth.box.low_m) / 0.1).astype(int)
    slots = voxels.allocate(np.floor_divide(index, 8).astype(np.int32))
    within = index % 8
    voxels.log_odds[slots, (within[:, 0] * 8 + within[:, 1]) * 8 + within[:, 2]] = 1.0
    scores = score_map(voxels, truth)
    assert set(scores["solid"]["exact"].values()) == {1.0}
    assert scores["surface"]["exact"]["recall"] == 1.0
    assert scores["surface"]["exact"]["precision"] < 1.0


def test_ghosts_are_what_is_occupied_in_open_water_alone() -> None:
    placed = place_mesh(tetrapod(), 0.0, 0.0, -20.0, np.eye(3))
    level = Seabed(np.full((40, 40), -20.0), 1.0, (-20.0, -20.0))
    body = Body("tetrapod", placed, Material("concrete"))
    scene = Scene((body,), level)
    truth = ground_truth(scene, (body,), 0.1)
    voxels = VoxelMap(0.1)
    region = Box((-6.0, -6.0, -21.0), (6.0, 6.0, -15.0))

    def occupy(*places_m: tuple[float, float, float]) -> None:
        for place in places_m:
            index = np.floor(np.array(place) / 0.1).astype(int)
            [slot] = voxels.allocate((index // 8)[None].astype(np.int32))
            x, y, z = index % 8
            voxels.log_odds[slot, x * 64 + y * 8 + z] = 1.0

    occupy((0.05, 0.05, -19.0))  # in the object's box
    occupy((5.05, 0.05, -20.05), (5.05, 0.05, -19.95))  # seabed, and the voxel over it
    occupy((9.05, 0.05, -18.0))  # outside the region
    assert ghosts(voxels.window(region), truth, scene) == 0.0
    occupy((5.05, 0.05, -19.75), (-5.05, 3.05, -16.0))
    share = 2 / np.count_nonzero(truth.solid & truth.scored)
    assert ghosts(voxels.window(region), truth, scene) == pytest.approx(share)
