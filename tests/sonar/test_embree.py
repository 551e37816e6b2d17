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
from insonify.sonar.embree import EchoHistogram, EmbreeRenderer, Response
from insonify.types import Float64, Pose

RESPONSE = Response(slope=6.0, centre=0.3)
RENDERER = EmbreeRenderer(2, 96, RESPONSE)
FLOOR = Seabed(np.zeros((2, 2)), 200.0, (-100.0, -100.0))


def _echo(intensity: float) -> float:
    return 1.0 / (1.0 + math.exp(-RESPONSE.slope * (intensity - RESPONSE.centre)))


def _body(mesh: trimesh.Trimesh, at: tuple[float, float, float]) -> Body:
    mesh.apply_translation(at)
    return Body("body", mesh, Material("steel", 1.0))


def _first_bin(histogram: EchoHistogram) -> np.ndarray:
    seen = histogram.samples > 1e-6
    return np.where(seen.any(axis=0), seen.argmax(axis=0), -1)


def _depression(device: SonarDevice, azimuth: Float64) -> Float64:
    """Steepest angle below the horizon that each beam of a tilted fan looks at."""
    low = np.full_like(azimuth, -math.radians(device.elevation_fov_deg) / 2)
    turn = world_from_sonar(Pose(0, 0, 0), math.radians(device.tilt_deg))[:3, :3]
    directions = directions_from_angles(azimuth, low) @ turn.T
    return -np.arcsin(directions[:, 2])


def test_level_seabed_starts_where_the_lowest_ray_meets_it() -> None:
    device = SonarDevice()
    geometry = device.geometry
    histogram = RENDERER.render(Scene((), FLOOR), geometry, Pose(0, 0, 5.0))
    expected = 5.0 / np.sin(_depression(device, geometry.beam_azimuths_rad))
    first = _first_bin(histogram) * geometry.bin_m
    np.testing.assert_allclose(first, expected, atol=1.5 * geometry.bin_m)
    assert first.min() == pytest.approx(5.0 / math.sin(math.radians(37)), abs=0.05)


def test_level_seabed_has_no_striping_and_the_cosine_of_incidence() -> None:
    geometry = SonarDevice().geometry
    histogram = RENDERER.render(Scene((), FLOOR), geometry, Pose(0, 0, 5.0))
    beam = geometry.beams // 2
    first = int(_first_bin(histogram)[beam])
    # the last bin lies beyond the upper edge of the fan, at 5 / sin(23 deg) = 12.797 m
    samples = histogram.samples[first + 2 : -1, beam]
    assert (samples > 0.0).all(), "a bin between filled ones is empty"
    mean = histogram.echo_sum[first + 2 : -1, beam] / samples
    ranges = geometry.bin_ranges_m[first + 2 : -1]
    np.testing.assert_allclose(mean, [_echo(5.0 / r) for r in ranges], rtol=0.01)
    # N itself is smooth: as many rays as the bin's share of the elevation
    assert (np.abs(np.diff(samples[:-1])) < 0.03 * samples[:-2]).all()


def test_wall_is_one_bin_deep_at_its_range() -> None:
    geometry = SonarDevice(tilt_deg=0.0).geometry
    wall = _body(trimesh.creation.box((0.1, 200.0, 200.0)), (7.06, 0.0, 0.0))
    histogram = RENDERER.render(Scene((wall,)), geometry, Pose(0, 0, 0))
    azimuth = geometry.beam_azimuths_rad
    nearest = 7.01 / np.cos(azimuth)
    np.testing.assert_allclose(
        _first_bin(histogram) * geometry.bin_m, nearest, atol=1.5 * geometry.bin_m
    )
    farthest = nearest / math.cos(geometry.elevation_fov_rad / 2)
    bins = np.arange(geometry.bins)[:, None]
    last = np.where(histogram.samples > 1e-6, bins, -1).max(axis=0) * geometry.bin_m
    np.testing.assert_allclose(last, farthest, atol=2.5 * geometry.bin_m)


def test_sphere_echoes_first_at_its_near_side_in_its_own_beams() -> None:
    geometry = SonarDevice(tilt_deg=0.0).geometry
    bearing, distance, radius = math.radians(8.0), 9.0, 0.5
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    place = (distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    histogram = RENDERER.render(Scene((_body(mesh, place),)), geometry, Pose(0, 0, 0))
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
    histogram = EmbreeRenderer(2, 400, RESPONSE).render(scene, geometry, Pose(0, 0, altitude))
    beam = geometry.beams // 2
    filled = np.flatnonzero(histogram.samples[:, beam] > 1e-6) * geometry.bin_m
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

    def image(renderer: EmbreeRenderer) -> tuple[np.ndarray, np.ndarray]:
        histogram = renderer.render(scene, geometry, Pose(0, 0, 5.0))
        seen = histogram.samples > 1e-6
        return seen, histogram.echo_sum / np.maximum(histogram.samples, 1e-6)

    seen, few = image(RENDERER)
    seen_by_many, many = image(EmbreeRenderer(16, 768, RESPONSE))
    error = (few - many)[seen & seen_by_many]
    assert np.sqrt((error**2).mean()) < 0.02
    assert (seen != seen_by_many).mean() < 0.005, "outlines differ"


def test_either_side_of_a_triangle_echoes_alike_and_reflectance_scales() -> None:
    geometry = SonarDevice(tilt_deg=0.0).geometry
    box = trimesh.creation.box((0.1, 50.0, 50.0))
    inverted = box.copy()
    inverted.invert()
    pose = Pose(-8.0, 0.0, 0.0)
    outward = RENDERER.render(Scene((_body(box.copy(), (0, 0, 0)),)), geometry, pose)
    inward = RENDERER.render(Scene((_body(inverted, (0, 0, 0)),)), geometry, pose)
    np.testing.assert_allclose(outward.echo_sum, inward.echo_sum, rtol=1e-5)
    dull = Body("dull", box, Material("mud", 0.25))
    faint = RENDERER.render(Scene((dull,)), geometry, pose)
    beam = geometry.beams // 2
    row = int(faint.samples[:, beam].argmax())
    assert faint.echo_sum[row, beam] / faint.samples[row, beam] == pytest.approx(
        _echo(0.25), rel=0.02
    )


def test_nothing_beyond_the_range_and_nothing_before_it() -> None:
    geometry = SonarDevice(range_min_m=9.0, range_max_m=10.0, bins=40).geometry
    histogram = RENDERER.render(Scene((), FLOOR), geometry, Pose(0, 0, 5.0))
    assert histogram.samples.shape == (40, 96)
    assert (histogram.samples[:, 48] > 0).all()
    assert RENDERER.render(Scene((), FLOOR), geometry, Pose(0, 0, 50.0)).samples.sum() == 0
