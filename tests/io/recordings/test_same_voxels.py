"""One recording through every container: the same occupied voxels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import samples
from benchmarks.bag_samples import BagMaker
from PIL import Image
from scipy.spatial.transform import Rotation

from insonify.frames import quaternion_from_rotation, transform_from_pose
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros.messages import IMAGE_FROM_SONAR
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.mission.setup import World, scenario_config
from insonify.types import Array, FanGeometry, Ping, Pose, PosedPing

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "recordings"
MAPPING = MappingSettings(voxel_m=0.1, pixel_threshold=26)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning"),
]


def _eight_bits(posed: PosedPing, number: int) -> PosedPing:
    """A ping as a device of 8 bits has it, at a time of its own."""
    image = (np.round(255.0 * posed.ping.image) / 255.0).astype(np.float32)
    return PosedPing(Ping(image, posed.ping.geometry, 100.0 + number), posed.pose)


@pytest.fixture(scope="module")
def turtle() -> list[PosedPing]:
    path = DATA / "holoocean_turtle.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    reading = Reading(beams="starboard-to-port")
    return [_eight_bits(one, number) for number, one in enumerate(open_recording(path, reading))]


@pytest.fixture(scope="module")
def scan() -> list[PosedPing]:
    """Twelve pings on the way round the tetrapod."""
    world, rng = World(scenario_config("tetrapod")), np.random.default_rng(5)
    pings = []
    for number in range(12):
        turn = math.radians(30.0 * number)
        yaw = math.remainder(turn + math.pi, math.tau)
        pose = Pose(8.0 * math.cos(turn), 8.0 * math.sin(turn), -15.0, 0.02, -0.03, yaw)
        ping = world.sonar.ping(world.scene, pose, rng)
        pings.append(_eight_bits(PosedPing(ping, pose), number))
    return pings


def _occupied(path: Path, reading: Reading = Reading()) -> set[tuple[int, ...]]:
    voxels = map_recordings([open_recording(path, reading)], MAPPING).mapper.voxels
    return {tuple(index) for index in np.floor(voxels.occupied_m() / 0.1).astype(int)}


def _bytes(posed: PosedPing) -> Array:
    return np.round(255.0 * posed.ping.image).astype(np.uint8)


def _quaternion(pose: Pose) -> Array:
    return quaternion_from_rotation(transform_from_pose(pose)[:3, :3])


def _poses(pings: list[PosedPing], path: Path) -> Path:
    rows = [
        [one.ping.time_s, *one.pose.position_m, *_quaternion(one.pose)]
        for one in pings
        if one.pose is not None
    ]
    np.savetxt(path, rows, fmt="%.17g")
    return path


def _archive(pings: list[PosedPing], folder: Path) -> set[tuple[int, ...]]:
    save_arrays(folder / "r.npz", pings)
    return _occupied(folder / "r.npz")


def _bag(kind: str) -> Callable[[list[PosedPing], Path], set[tuple[int, ...]]]:
    def route(pings: list[PosedPing], folder: Path) -> set[tuple[int, ...]]:
        maker, fan = BagMaker(kind), pings[0].ping.geometry
        mount = transform_from_pose(fan.mount) @ IMAGE_FROM_SONAR
        turn = Rotation.from_matrix(mount[:3, :3]).as_quat()
        messages = [
            ("/tf_static", 99.0, maker.link(99.0, "base_link", "sonar", mount[:3, 3], turn))
        ]
        for one in pings:
            assert one.pose is not None
            now, place = one.ping.time_s, np.array(one.pose.position_m)
            messages.append(("/odom", now, maker.odometry(now, place, _quaternion(one.pose))))
            message = maker.projected(
                now, _bytes(one), fan.beam_azimuths_rad, fan.bin_ranges_m, fan.elevation_fov_rad
            )
            messages.append(("/sonar", now, message))
        return _occupied(maker.write(folder / kind, messages))

    return route


def _images(pings: list[PosedPing], folder: Path) -> set[tuple[int, ...]]:
    fan, place = pings[0].ping.geometry, folder / "images"
    place.mkdir()
    for one in pings:
        Image.fromarray(_bytes(one)).save(place / f"{one.ping.time_s:.3f}.png")
    _poses(pings, place / "poses.tum")
    (place / "sonar.toml").write_text(
        f"azimuth_fov_deg = {math.degrees(fan.azimuth_fov_rad)!r}\n"
        f"elevation_fov_deg = {math.degrees(fan.elevation_fov_rad)!r}\n"
        f"range_min_m = {fan.range_min_m!r}\nrange_max_m = {fan.range_max_m!r}\n"
        f"tilt_deg = {math.degrees(fan.mount.pitch_rad)!r}\n"
    )
    return _occupied(place, Reading(beams="port-to-starboard"))


ROUTES = {
    "ROS 1": _bag("ros1"),
    "ROS 2": _bag("db3"),
    "MCAP": _bag("mcap"),
    "images": _images,
}


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("source", ["turtle", "scan"])
def test_the_same_occupied_voxels_by_every_route(
    route: str, source: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    pings = request.getfixturevalue(source)
    expected = _archive(pings, tmp_path)
    assert len(expected) > 200
    assert ROUTES[route](pings, tmp_path) == expected


def test_the_same_through_a_file_of_oculus_shape(scan: list[PosedPing], tmp_path: Path) -> None:
    """Whose ranges begin at 0 and whose bearings are hundredths of a degree."""
    bearings = np.round(np.linspace(-14.25, 14.25, 96), 2)
    step = 0.01
    fan = FanGeometry(
        azimuth_fov_rad=math.radians(28.8),
        elevation_fov_rad=math.radians(14.0),
        beams=96,
        bins=513,
        range_min_m=0.0,
        range_max_m=513 * step,
        mount=scan[0].ping.geometry.mount,
    )
    near = [replace(one, ping=replace(one.ping, geometry=fan)) for one in scan]
    raw = b"".join(samples.oculus(_bytes(one), bearings) for one in near)
    (tmp_path / "o.raw").write_bytes(raw)
    _poses(near, tmp_path / "p.tum")
    mount = near[0].ping.geometry.mount
    sonar = tmp_path / "s.toml"
    sonar.write_text("elevation_fov_deg = 14.0\nrange_max_m = 20.0\n")
    from insonify.sonar.devices import named_device

    reading = Reading(device=named_device(str(sonar)), poses=tmp_path / "p.tum", mount=mount)
    (first, *_) = open_recording(tmp_path / "o.raw", reading)
    even = [replace(one, ping=replace(one.ping, geometry=first.ping.geometry)) for one in near]
    assert first.ping.geometry.azimuth_fov_rad == pytest.approx(fan.azimuth_fov_rad, abs=1e-4)
    assert _occupied(tmp_path / "o.raw", reading) == _archive(even, tmp_path)
