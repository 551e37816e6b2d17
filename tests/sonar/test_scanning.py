"""Sweeps of a head in a square room: where its walls come out is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from insonify.frames import transform_from_pose
from insonify.scene import Body, Scene
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice, named_device
from insonify.sonar.formation import ImageSettings
from insonify.sonar.physical import PhysicalSettings
from insonify.sonar.scanning import (
    SIDES_RAD,
    deskewed_image,
    head_angles,
    polar_image,
    sidescan_line,
    soundings,
    sweep,
)
from insonify.types import Float64, Ping, Pose, PosedPing

DEVICE = SonarDevice(
    name="head", kind="scanning", azimuth_fov_deg=3, elevation_fov_deg=20, beams=1, bins=400,
    range_max_m=10, step_deg=2.0, tilt_deg=0,
)  # fmt: skip
QUIET = ImageSettings(speckle=0, noise=0)
HALF = 4.0


def _room() -> Scene:
    """A room 8 m square, without floor."""
    walls = []
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        wall = trimesh.creation.box((0.1 + 8.2 * abs(y), 0.1 + 8.2 * abs(x), 20.0))
        wall.apply_translation((x * (HALF + 0.05), y * (HALF + 0.05), 0.0))
        walls.append(Body(f"wall {x} {y}", wall))
    return Scene(tuple(walls))


def _turn(pose_at: object, device: SonarDevice = DEVICE, number: int = 0) -> list[PosedPing]:
    sonar, scene = Sonar(device, image=QUIET), _room()
    moments = sweep(device, pose_at, number=number)  # type: ignore[arg-type]
    poses, heads_rad, times_s = zip(*moments, strict=True)
    pings = sonar.pings(scene, poses, heads_rad=heads_rad, times_s=times_s)
    return list(map(PosedPing, pings, poses))


def _first(turn: list[PosedPing]) -> Pose:
    assert turn[0].pose is not None
    return turn[0].pose


def _walls_error(image: Ping, centre: Pose) -> Float64:
    """For each beam, how far the middle of its echo is from the room's wall along it."""
    range_m = image.geometry.bin_ranges_m[:, None]
    echo = np.maximum(image.image, 1e-9)  # a beam that hears nothing is where no wall is
    found = (echo * range_m).sum(axis=0) / echo.sum(axis=0)
    azimuth = image.geometry.beam_azimuths_rad + centre.yaw_rad
    gaps = []
    for speed, at in ((np.cos(azimuth), centre.x_m), (np.sin(azimuth), centre.y_m)):
        with np.errstate(divide="ignore"):
            gaps.append(np.where(speed > 0, (HALF - at) / speed, (-HALF - at) / speed))
    return np.asarray(found - np.minimum(*gaps))


def test_a_full_turn_at_rest_shows_the_room() -> None:
    centre = Pose(0.7, -0.4, 0.0, yaw_rad=0.3)
    turn = _turn(lambda time_s: centre)
    image = polar_image(turn, DEVICE)
    assert image.image.shape == (400, 180)
    assert math.degrees(image.geometry.azimuth_fov_rad) == pytest.approx(360.0)
    assert np.abs(_walls_error(image, centre)).max() < 0.12  # at corners; half of it the bin


@pytest.mark.parametrize("device", [DEVICE, SonarDevice(beams=24, bins=90)])
@pytest.mark.parametrize("physical", [None, PhysicalSettings()])
def test_pings_together_are_those_one_by_one(
    device: SonarDevice, physical: PhysicalSettings | None
) -> None:
    poses = [Pose(0.1 * k, 0.2, -1.0, yaw_rad=0.2 * k) for k in range(11)]
    heads, times = np.linspace(-1.0, 1.0, 11), np.arange(11.0)
    many = Sonar(device, physical=physical).pings(
        _room(), poses, np.random.default_rng(5), heads_rad=heads, times_s=times
    )
    alone, rng = Sonar(device, physical=physical), np.random.default_rng(5)
    for ping, pose, head, time_s in zip(many, poses, heads, times, strict=True):
        own = alone.ping(_room(), pose, rng, head_rad=float(head), time_s=float(time_s))
        np.testing.assert_array_equal(ping.image, own.image)
        assert (ping.geometry, ping.time_s, ping.head_rad) == (own.geometry, time_s, head)
    assert next(many, None) is None


def test_a_pose_without_its_angle_is_refused() -> None:
    poses = [Pose(0.0, 0.0, -1.0)] * 3
    with pytest.raises(ValueError, match="shorter"):
        list(Sonar(DEVICE).pings(_room(), poses, heads_rad=[0.0, 0.1]))


def test_each_ping_has_its_own_time_and_pose() -> None:
    turn = _turn(lambda time_s: Pose(time_s, 0.0, 0.0))
    times = np.array([one.ping.time_s for one in turn])
    np.testing.assert_allclose(np.diff(times), 2 * 10.0 / 1500.0)
    np.testing.assert_allclose([one.pose.x_m for one in turn if one.pose is not None], times)


def test_turning_distorts_the_room_and_deskewing_straightens_it() -> None:
    """The paper's second experiment: 20 degrees to the left during the turn."""
    length_s = 179 * 2 * 10.0 / 1500.0

    def pose_at(time_s: float) -> Pose:
        return Pose(0.5, 0.2, 0.0, yaw_rad=math.radians(20.0) * time_s / length_s)

    turn = _turn(pose_at)
    skewed = np.abs(_walls_error(polar_image(turn, DEVICE), _first(turn)))
    straight = np.abs(_walls_error(deskewed_image(turn, DEVICE, _first(turn)), _first(turn)))
    sector = slice(12, -12)  # the turn leaves a gap at its seam
    assert skewed[sector].max() > 0.5
    assert straight[sector].max() < 0.2
    assert np.mean(straight[sector]) < 0.25 * np.mean(skewed[sector])


def test_deskewing_a_turn_at_rest_changes_little() -> None:
    turn = _turn(lambda time_s: Pose(0.5, 0.2, 0.0))
    plain, moved = polar_image(turn, DEVICE), deskewed_image(turn, DEVICE, _first(turn))
    assert np.abs(_walls_error(moved, _first(turn))).max() < 0.2
    assert abs(plain.image.mean() - moved.image.mean()) < 0.1 * plain.image.mean()


def test_a_head_that_goes_back_and_forth_sees_the_same_from_the_other_end() -> None:
    device = DEVICE.model_copy(update={"sector_deg": 90.0, "back_and_forth": True})
    there, back = (_turn(lambda time_s: Pose(0, 0, 0), device, number) for number in (0, 1))
    assert there[0].ping.head_rad == -back[0].ping.head_rad > 0
    np.testing.assert_array_equal(polar_image(there, device).image, polar_image(back, device).image)


@given(step=st.floats(0.3, 60.0), sector=st.floats(60.0, 360.0))
def test_head_angles_stay_in_the_sector_and_are_even(step: float, sector: float) -> None:
    device = DEVICE.model_copy(update={"step_deg": step, "sector_deg": sector})
    degrees = np.degrees(head_angles(device))
    assert np.allclose(np.diff(degrees), -step) and np.allclose(degrees, -degrees[::-1])
    assert len(degrees) * step <= sector * (1 + 1e-9) < (len(degrees) + 1) * step * (1 + 2e-9)


def test_a_tilted_head_scans_the_plane_across_the_track() -> None:
    device = DEVICE.model_copy(update={"tilt_deg": 90.0})
    for degrees, expected in ((0.0, (0, 0, -1)), (90.0, (0, 1, 0)), (-90.0, (0, -1, 0))):
        mount = device.geometry_at(math.radians(degrees)).mount
        np.testing.assert_allclose(transform_from_pose(mount)[:3, 0], expected, atol=1e-9)


def test_side_scan_hears_the_seabed_from_below_outwards_on_both_sides() -> None:
    floor = trimesh.creation.box((200.0, 200.0, 1.0))
    floor.apply_translation((0.0, 0.0, -10.5))
    rock = trimesh.creation.box((4.0, 2.0, 2.0))
    rock.apply_translation((0.0, 20.0, -9.0))
    scene = Scene((Body("floor", floor), Body("rock", rock)))
    sonar = Sonar(named_device("sidescan"), image=QUIET)

    def line(x_m: float) -> Float64:
        pose = Pose(x_m, 0.0, 0.0)
        port, starboard = (sonar.ping(scene, pose, head_rad=side).image for side in SIDES_RAD)
        return np.asarray(sidescan_line(port, starboard), np.float64)

    bins, bin_m = 1024, 50.0 / 1024
    empty, beside = line(30.0), line(0.0)
    np.testing.assert_allclose(empty[:bins][::-1], empty[bins:], atol=0.05)
    first = np.flatnonzero(empty[bins:] > 0.01)[0] * bin_m
    assert first == pytest.approx(10.0 / math.sin(math.radians(45.0)), abs=0.3)
    port, starboard = beside[:bins][::-1], beside[bins:]
    shadow = slice(int(23.5 / bin_m), int(25.5 / bin_m))  # behind the rock's far top edge
    assert port[shadow].max() == 0.0 and starboard[shadow].min() > 0.0


def test_soundings_lie_on_the_seabed() -> None:
    floor = trimesh.creation.box((200.0, 200.0, 1.0))
    floor.apply_translation((0.0, 0.0, -10.5))
    sonar = Sonar(named_device("profiler"), image=QUIET)
    pose = Pose(3.0, 2.0, 0.0, yaw_rad=0.7)
    points = soundings(PosedPing(sonar.ping(Scene((Body("floor", floor),)), pose), pose), 0.05)
    assert len(points) > 200
    assert np.abs(points[:, 2] + 10.0).max() < 0.2
    across = (points[:, :2] - (3.0, 2.0)) @ (math.cos(0.7), math.sin(0.7))
    assert np.abs(across).max() < 0.05
