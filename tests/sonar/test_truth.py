"""Ground truth against geometry known in closed form."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from insonify.errors import RendererError
from insonify.scene import Body, Scene
from insonify.scene.named import named_scene
from insonify.scene.worlds import WorldWarning
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice, named_device
from insonify.sonar.opengl import OpenGLRenderer
from insonify.sonar.physical import PhysicalSettings
from insonify.sonar.truth import Truth
from insonify.types import Float64, Pose

DATA = Path(__file__).resolve().parents[3] / "shared/data"
DEVICE = SonarDevice(
    azimuth_fov_deg=60, elevation_fov_deg=20, beams=60, bins=300, range_max_m=30, tilt_deg=0
)
DOWN = Pose(2.0, -3.0, 6.0, pitch_rad=math.radians(25.0), yaw_rad=0.3)


def _box(extents: tuple[float, float, float], centre: Float64) -> trimesh.Trimesh:
    box: trimesh.Trimesh = trimesh.creation.box(extents)
    box.apply_translation(centre)
    return box


def _ahead(distance_m: float) -> Float64:
    return np.array([2.0 + distance_m * math.cos(0.3), -3.0 + distance_m * math.sin(0.3), 0.0])


def _scene() -> Scene:
    """A level floor at z = 0 with a block of 2 m on it, 11 m ahead of the sonar's foot."""
    floor = _box((200.0, 200.0, 1.0), np.array([0.0, 0.0, -0.5]))
    block = _box((2.0, 2.0, 2.0), _ahead(11.0) + np.array([0.0, 0.0, 1.0]))
    return Scene((Body("floor", floor), Body("block", block)))


@pytest.fixture(scope="module", params=["embree", "opengl"])
def truth(request: pytest.FixtureRequest) -> Truth:
    if request.param == "embree":
        return Sonar(DEVICE).truth(_scene(), DOWN)
    try:
        return Sonar(DEVICE, renderer=OpenGLRenderer()).truth(_scene(), DOWN)
    except RendererError as err:
        pytest.skip(str(err))


def test_points_lie_on_their_bodies_in_their_cells(truth: Truth) -> None:
    floor = truth.label == 0
    assert floor.sum() > 3000
    half_sample_m = 30.0 * math.radians(20.0 / 64) / 2
    assert np.abs(truth.point_m[floor][:, 2]).max() < 1.6 * half_sample_m
    block = truth.label == 1
    assert block.sum() > 100
    top_or_side = truth.point_m[block] - (_ahead(11.0) + np.array([0.0, 0.0, 1.0]))
    assert np.abs(top_or_side).max() < math.hypot(1.0, 1.0) + 0.1
    distance = np.linalg.norm(truth.point_m - np.array(DOWN.position_m), axis=2)
    bins, _ = np.nonzero(truth.label >= 0)
    assert np.abs(distance[truth.label >= 0] - (bins + 0.5) * 0.1).max() <= 0.0501
    np.testing.assert_allclose(distance[floor], truth.range_m[floor], atol=1e-3)


def test_elevation_is_that_of_the_floor(truth: Truth) -> None:
    rows, beams = np.nonzero(truth.label == 0)
    straight = beams == 30  # azimuth -0.5 degrees: elevation below the horizon is asin(6 / r)
    expected = math.radians(25.0) - np.arcsin(6.0 / truth.range_m[rows, beams][straight])
    found = truth.elevation_rad[rows, beams][straight]
    assert np.abs(found - expected).max() < math.radians(0.3)


def test_the_block_throws_a_shadow_as_long_as_geometry_says(truth: Truth) -> None:
    """Light from 6 m over a 2 m block: the shadow ends at 6 / (6 - 2) of the far top edge."""
    beam = 30
    end_m = math.hypot(12.0 * 6.0 / 4.0, 6.0)
    shadow = np.flatnonzero(truth.shadow[:, beam]) * 0.1
    assert shadow.max() == pytest.approx(end_m, abs=0.25)
    top_far_m = math.hypot(12.0, 4.0)
    assert shadow.min() == pytest.approx(top_far_m, abs=0.25)
    assert len(shadow) * 0.1 == pytest.approx(end_m - top_far_m, abs=0.5)
    assert not truth.shadow[truth.label >= 0].any()


def test_beams_beside_the_block_have_no_shadow(truth: Truth) -> None:
    assert not truth.shadow[:, :10].any() and not truth.shadow[:, -10:].any()


def test_first_returns_are_one_a_beam_and_the_nearest(truth: Truth) -> None:
    assert (truth.first_return.sum(axis=0) == 1).all()
    echoes = truth.label >= 0
    assert (truth.first_return.argmax(axis=0) == echoes.argmax(axis=0)).all()
    assert truth.labels == ("floor", "block")


def test_an_empty_view_has_no_truth() -> None:
    up = Pose(0.0, 0.0, 6.0, pitch_rad=-1.2)
    nothing = Sonar(DEVICE).truth(_scene(), up)
    assert (nothing.label == -1).all() and not nothing.first_return.any()
    assert not nothing.shadow.any() and np.isnan(nothing.range_m).all()


def test_the_truth_leaves_mirrors_out() -> None:
    """With the water's surface at z = 0 as a mirror, the same truth as without."""
    sunk = Scene((Body("block", _box((2.0, 2.0, 2.0), np.array([10.0, 0.0, -3.0]))),))
    device = DEVICE.model_copy(update={"elevation_fov_deg": 90.0})
    eye = Pose(0.0, 0.0, -3.0)
    plain = Sonar(device, physical=PhysicalSettings())
    mirrored = Sonar(device, physical=PhysicalSettings(surface_mirror=True, second_bounce=True))
    assert (plain.ping(sunk, eye).image != mirrored.ping(sunk, eye).image).any()
    before, after = plain.truth(sunk, eye), mirrored.truth(sunk, eye)
    np.testing.assert_array_equal(before.label, after.label)
    np.testing.assert_array_equal(before.point_m, after.point_m)


def test_shadow_behind_a_low_crest_has_no_stripes() -> None:
    """What a crest far away hides is seen by few even rays; by those of divided patches, by all."""
    world = DATA / "worlds/sunken_ship_site.world"
    if not world.is_file():
        pytest.skip(f"needs {world.name} in ../shared/data, which is not here")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WorldWarning)  # a texture is not there
        scene = named_scene(str(world), [DATA / "models"])
    device = named_device("gemini-720is").model_copy(update={"bins": 512, "range_max_m": 120.0})
    pose = Pose(20.0, 0.0, -50.0, pitch_rad=math.radians(20.0), yaw_rad=math.pi)
    shadow = Sonar(device).truth(scene, pose).shadow
    starboard = shadow[device.geometry.bin_ranges_m > 112.0, 452:]
    flips = (np.diff(starboard.astype(int), axis=1) != 0).sum(axis=1)
    assert starboard.mean() > 0.5
    assert flips.mean() < 4.0, "14 of 60 beams and more, with even rays alone"
