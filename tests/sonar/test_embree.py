"""The renderer against scenes whose echoes are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from insonify.frames import directions_from_angles, world_from_sonar
from insonify.scene import Body, Material, Scene
from insonify.scene.seabed import Seabed
from insonify.sonar.devices import SonarDevice
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.formation import normalise_energy
from insonify.sonar.histogram import EchoHistogram, Law, Response
from insonify.sonar.sampling import SamplingSettings, UndersamplingWarning, even_samples
from insonify.types import FanGeometry, Float64, Pose

RESPONSE = Response(Law.SIGMOID, slope=6.0, centre=0.3)
FLOOR = Seabed(np.zeros((2, 2)), 200.0, (-100.0, -100.0))


def _render(
    scene: Scene,
    geometry: FanGeometry,
    pose: Pose,
    sampling: SamplingSettings = SamplingSettings(),
    response: Response = RESPONSE,
) -> EchoHistogram:
    return EmbreeRenderer(sampling).render(scene, geometry, pose, response)


def _echo(intensity: float) -> float:
    return 1.0 / (1.0 + math.exp(-RESPONSE.slope * (intensity - RESPONSE.centre)))


def _body(mesh: trimesh.Trimesh, at: tuple[float, float, float]) -> Body:
    mesh.apply_translation(at)
    return Body("body", mesh, Material("steel", 1.0))


def _first_bin(histogram: EchoHistogram) -> np.ndarray:
    seen = histogram.coverage > 1e-7
    return np.where(seen.any(axis=0), seen.argmax(axis=0), -1)


def _depression(device: SonarDevice, azimuth: Float64) -> Float64:
    """Steepest angle below the horizon that each beam of a tilted fan looks at."""
    low = np.full_like(azimuth, -math.radians(device.elevation_fov_deg) / 2)
    turn = world_from_sonar(Pose(0, 0, 0), device.geometry.mount)[:3, :3]
    directions = directions_from_angles(azimuth, low) @ turn.T
    return -np.arcsin(directions[:, 2])


def test_level_seabed_starts_where_the_lowest_ray_meets_it() -> None:
    device = SonarDevice()
    geometry = device.geometry
    histogram = _render(Scene((), FLOOR), geometry, Pose(0, 0, 5.0))
    expected = 5.0 / np.sin(_depression(device, geometry.beam_azimuths_rad))
    first = _first_bin(histogram) * geometry.bin_m
    np.testing.assert_allclose(first, expected, atol=1.5 * geometry.bin_m)
    assert first.min() == pytest.approx(5.0 / math.sin(math.radians(37)), abs=0.05)


def test_level_seabed_has_no_striping_and_the_cosine_of_incidence() -> None:
    geometry = SonarDevice().geometry
    histogram = _render(Scene((), FLOOR), geometry, Pose(0, 0, 5.0))
    beam = geometry.beams // 2
    first = int(_first_bin(histogram)[beam])
    # the last bin lies beyond the upper edge of the fan, at 5 / sin(23 deg) = 12.797 m
    coverage = histogram.coverage[first + 2 : -1, beam]
    assert (coverage > 0.0).all(), "a bin between filled ones is empty"
    mean = histogram.echo[first + 2 : -1, beam] / coverage
    ranges = geometry.bin_ranges_m[first + 2 : -1]
    np.testing.assert_allclose(mean, [_echo(5.0 / r) for r in ranges], rtol=0.01)
    # N itself is smooth: as many rays as the bin's share of the elevation
    assert (np.abs(np.diff(coverage[:-1])) < 0.03 * coverage[:-2]).all()


@pytest.mark.parametrize(("tilt_deg", "altitude_m"), [(8.0, 1.0), (12.0, 1.5), (60.0, 5.0)])
def test_seabed_at_any_grazing_angle_leaves_no_bin_empty(
    tilt_deg: float, altitude_m: float
) -> None:
    device = SonarDevice(tilt_deg=tilt_deg, azimuth_fov_deg=60.0, range_max_m=20.0, bins=800)
    histogram = _render(Scene((), FLOOR), device.geometry, Pose(0, 0, altitude_m))
    for beam in range(device.beams):
        filled = np.flatnonzero(histogram.coverage[:, beam] > 1e-7)
        assert len(filled) == filled[-1] - filled[0] + 1


def test_wall_is_one_bin_deep_at_its_range() -> None:
    geometry = SonarDevice(tilt_deg=0.0).geometry
    wall = _body(trimesh.creation.box((0.1, 200.0, 200.0)), (7.06, 0.0, 0.0))
    histogram = _render(Scene((wall,)), geometry, Pose(0, 0, 0))
    azimuth = geometry.beam_azimuths_rad
    nearest = 7.01 / np.cos(azimuth)
    np.testing.assert_allclose(
        _first_bin(histogram) * geometry.bin_m, nearest, atol=1.5 * geometry.bin_m
    )
    farthest = nearest / math.cos(geometry.elevation_fov_rad / 2)
    bins = np.arange(geometry.bins)[:, None]
    last = np.where(histogram.coverage > 1e-7, bins, -1).max(axis=0) * geometry.bin_m
    np.testing.assert_allclose(last, farthest, atol=2.5 * geometry.bin_m)


def test_sphere_echoes_first_at_its_near_side_in_its_own_beams() -> None:
    geometry = SonarDevice(tilt_deg=0.0).geometry
    bearing, distance, radius = math.radians(8.0), 9.0, 0.5
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    place = (distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    histogram = _render(Scene((_body(mesh, place),)), geometry, Pose(0, 0, 0))
    first = _first_bin(histogram)
    hit = np.flatnonzero(first >= 0)
    nearest = first[hit].min() * geometry.bin_m
    assert nearest == pytest.approx(distance - radius, abs=1.5 * geometry.bin_m)
    azimuth = geometry.beam_azimuths_rad
    edge = math.asin(radius / distance)
    expected = np.flatnonzero(np.abs(azimuth - bearing) < edge)
    assert abs(hit[0] - expected[0]) <= 1
    assert abs(hit[-1] - expected[-1]) <= 1
    assert hit[-1] < geometry.beams / 2, "a target to port belongs in the first beams"


def test_shadow_ends_where_the_ray_over_the_top_meets_the_seabed() -> None:
    device = SonarDevice(elevation_fov_deg=40.0, range_max_m=20.0, bins=800)
    geometry = device.geometry
    height, distance, altitude = 1.0, 6.0, 5.0
    plate = _body(trimesh.creation.box((0.02, 40.0, height)), (distance, 0.0, height / 2))
    scene = Scene((plate,), FLOOR)
    histogram = _render(scene, geometry, Pose(0, 0, altitude))
    beam = geometry.beams // 2
    filled = np.flatnonzero(histogram.coverage[:, beam] > 1e-6) * geometry.bin_m
    reach = distance * altitude / (altitude - height)
    shadow_end = math.hypot(reach, altitude)
    base = math.hypot(distance, altitude)
    dark = filled[(filled > base + 0.1) & (filled < shadow_end + 1.0)]
    assert dark.min() == pytest.approx(shadow_end, abs=0.06)


def test_few_rays_give_the_image_of_very_many() -> None:
    """Sharing a patch's echo among bins, against 64 times the samples."""
    geometry = SonarDevice().geometry
    x, y = np.meshgrid(np.linspace(-20, 20, 161), np.linspace(-20, 20, 161))
    relief = Seabed(0.1 * np.sin(1.3 * x) * np.cos(0.9 * y), 0.25, (-20.0, -20.0))
    ball = _body(trimesh.creation.icosphere(subdivisions=4, radius=1.2), (7.0, 0.3, 0.8))
    scene = Scene((ball,), relief)

    def image(sampling: SamplingSettings) -> np.ndarray:
        return normalise_energy(_render(scene, geometry, Pose(0, 0, 5.0), sampling))

    across, over = even_samples(geometry, SamplingSettings())
    many = SamplingSettings(across_beam=8 * across, over_elevation=8 * over, refine=1)
    error = image(SamplingSettings()) - image(many)
    assert np.sqrt((error**2).mean()) < 0.02


def test_edges_are_refined_and_coarse_sampling_warns() -> None:
    geometry = SonarDevice().geometry
    ball = _body(trimesh.creation.icosphere(subdivisions=4, radius=1.2), (7.0, 0.3, 0.8))
    scene = Scene((ball,), FLOOR)
    only_even = SamplingSettings(refine=1)
    renderers = [EmbreeRenderer(s) for s in (only_even, SamplingSettings())]
    even, refined = (
        [s.weight.sum() for s in r.sample(scene, geometry, Pose(0, 0, 5.0), RESPONSE)]
        for r in renderers
    )
    assert len(even) == 1 and len(refined) == 2
    assert sum(refined) == pytest.approx(sum(even), rel=0.01)
    assert 0.0 < refined[0] < 0.2 * sum(even)
    with pytest.warns(UndersamplingWarning, match="over_elevation=8 is too coarse"):
        _render(scene, geometry, Pose(0, 0, 5.0), SamplingSettings(over_elevation=8))


def test_either_side_of_a_triangle_echoes_alike_and_reflectance_scales() -> None:
    geometry = SonarDevice(tilt_deg=0.0).geometry
    box = trimesh.creation.box((0.1, 50.0, 50.0))
    inverted = box.copy()
    inverted.invert()
    pose = Pose(-8.0, 0.0, 0.0)
    outward = _render(Scene((_body(box.copy(), (0, 0, 0)),)), geometry, pose)
    inward = _render(Scene((_body(inverted, (0, 0, 0)),)), geometry, pose)
    np.testing.assert_allclose(outward.echo, inward.echo, rtol=1e-5)
    dull = Body("dull", box, Material("mud", 0.25))
    faint = _render(Scene((dull,)), geometry, pose)
    beam = geometry.beams // 2
    row = int(faint.coverage[:, beam].argmax())
    assert faint.echo[row, beam] / faint.coverage[row, beam] == pytest.approx(_echo(0.25), rel=0.02)


def test_nothing_beyond_the_range_and_nothing_before_it() -> None:
    geometry = SonarDevice(range_min_m=9.0, range_max_m=10.0, bins=40).geometry
    histogram = _render(Scene((), FLOOR), geometry, Pose(0, 0, 5.0))
    assert histogram.coverage.shape == (40, 96)
    assert (histogram.coverage[:, 48] > 0).all()
    assert _render(Scene((), FLOOR), geometry, Pose(0, 0, 50.0)).coverage.sum() == 0
