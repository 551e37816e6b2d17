"""Logs of viewers and autopilots: made ones in closed form, and a real one by another reader."""

from __future__ import annotations

import math
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import samples
from scipy.ndimage import maximum_filter
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import MissingExtraError, RecordingError
from insonify.frames import transform_from_pose
from insonify.io.recordings import open_recording
from insonify.io.recordings.poses import read_poses
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.io.recordings.summary import summarise
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.types import Box, Pose

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "recordings"


def _file(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


@pytest.mark.parametrize("packed", [False, True])
def test_an_oculus_log_holds_the_pings_of_a_raw_file_and_their_times(
    tmp_path: Path, rng: np.random.Generator, packed: bool
) -> None:
    bearings = np.linspace(-20.0, 20.0, 9)
    messages = [samples.oculus(samples.pixels(rng, 12, 9), bearings) for _ in range(3)]
    raw = list(open_recording(_file(tmp_path, "o.raw", b"".join(messages))))
    log = samples.oculus_log(messages, packed=packed)
    recording = open_recording(_file(tmp_path, "o.oculus", log))
    assert recording.timed and recording.count == 3
    for number, (one, other) in enumerate(zip(raw, recording, strict=True)):
        np.testing.assert_array_equal(one.ping.image, other.ping.image)
        assert one.ping.geometry == other.ping.geometry
        assert other.ping.time_s == pytest.approx(1.7e9 + 0.1 * number)
    junk = log[:48] + b"junk" * 9 + log[48:-10]
    with pytest.warns(RecordingWarning, match="damaged or cut off"):
        assert open_recording(_file(tmp_path, "j.oculus", junk)).count == 3
    secret = log[:26] + struct.pack("<H", 1) + log[28:]
    with pytest.raises(RecordingError, match="encrypted"):
        open_recording(_file(tmp_path, "e.oculus", secret))


@pytest.mark.parametrize(("chunk", "utf16"), [(None, True), (None, False), (70, True)])
def test_a_ping360_log(
    tmp_path: Path, rng: np.random.Generator, chunk: int | None, utf16: bool
) -> None:
    """200 gradians are ahead and angles rise to starboard; upside down, to port."""
    echoes = samples.pixels(rng, 5, 300)
    log = samples.ping360_log([200, 300, 0, 100, 250], echoes, chunk=chunk, utf16=utf16)
    path = _file(tmp_path, "p.bin", log)
    pings = [one.ping for one in open_recording(path)]
    yaws = [math.degrees(one.geometry.mount.yaw_rad) for one in pings]
    assert [abs(yaw) if abs(yaw) > 179 else yaw for yaw in yaws] == pytest.approx(
        [0.0, -90.0, 180.0, 90.0, -45.0]
    )
    for ping, one in zip(pings, echoes, strict=True):
        np.testing.assert_allclose(ping.image[:, 0], one / 255.0, atol=1e-7)
        assert ping.geometry.bin_m == pytest.approx(444 * 25e-9 * 1500.0 / 2.0)
    if chunk is None:
        assert [ping.time_s for ping in pings] == pytest.approx(0.035 * np.arange(5))
    over = open_recording(path, Reading(mount=Pose(0.0, 0.0, -0.2, math.pi, 0.0, 0.0)))
    ahead = [transform_from_pose(one.ping.geometry.mount)[:3, 0] for one in over]
    np.testing.assert_allclose(ahead[1], [0.0, 1.0, 0.0], atol=1e-12)
    doubts = str(over.facts["doubts"])
    assert "head is taken to point up" in doubts and "1500 m/s" in doubts
    with pytest.warns(RecordingWarning, match="damaged or cut off"):
        assert open_recording(_file(tmp_path, "c.bin", log[:-9])).count == 4
    with pytest.raises(RecordingError, match="Ping1D"):
        wrong = log.replace(struct.pack(">ii", 1, 2), struct.pack(">ii", 1, 1), 1)
        open_recording(_file(tmp_path, "d.bin", wrong))


@pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning")
def test_a_ping360_log_maps_a_wall_with_poses_beside(tmp_path: Path) -> None:
    """A wall 3 m to starboard of a vehicle at rest that looks north."""
    angles = list(range(260, 341, 4))
    per_bin = 444 * 25e-9 * 750.0
    echoes = np.zeros((len(angles), 600), np.uint8)
    for row, angle in zip(echoes, angles, strict=True):
        away = 3.0 / math.cos((angle - 300) * math.pi / 200)
        row[int(away / per_bin) - 1 : int(away / per_bin) + 2] = 255
    path = _file(tmp_path, "p.bin", samples.ping360_log(angles, echoes))
    poses = "".join(f"{t} 10 20 -5 0 0 {math.sqrt(0.5)} {math.sqrt(0.5)}\n" for t in (-1, 0.5, 2))
    (tmp_path / "p.tum").write_text(poses)
    recording = open_recording(path, Reading(poses=tmp_path / "p.tum"))
    remap = map_recordings([recording], MappingSettings())
    occupied = remap.mapper.voxels.occupied_m()
    assert len(occupied) > 100
    flat = np.abs(occupied[:, 2] + 5.0) < 0.2
    np.testing.assert_allclose(occupied[flat, 0], 13.0, atol=0.15)  # east of it
    assert np.ptp(occupied[flat, 1]) > 3.0
    _, turn = summarise(recording)
    assert turn is not None and turn.geometry.beams == len(angles)
    assert np.degrees(turn.geometry.beam_rad) == pytest.approx(3.6, abs=1e-3)


def _tlog(path: Path, mavlink: Any, count: int = 40) -> Path:
    """A vehicle that turns and goes north; its clock started at 1.7e9, messages come late."""
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    late = np.random.default_rng(0).exponential(0.02, 4 * count)
    late[7] = 0.0
    with path.open("wb") as file:
        for number in range(4 * count):
            boot_s = 50.0 + 0.05 * number
            messages = [
                sender.attitude_encode(round(1e3 * boot_s), 0.1, -0.2, 0.01 * number, 0, 0, 0)
            ]
            if number % 6 == 0:
                where = (0.02 * number, 3.0, 7.5)
                messages.append(
                    sender.local_position_ned_encode(round(1e3 * boot_s), *where, 0, 0, 0)
                )
                messages.append(sender.heartbeat_encode(12, 3, 0, 0, 4))
            for message in messages:
                stamp = round(1e6 * (1.7e9 + boot_s + late[number]))
                file.write(struct.pack(">Q", stamp) + message.pack(sender))
    return path


def test_poses_of_telemetry(tmp_path: Path) -> None:
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common")
    track = read_poses(_tlog(tmp_path / "d.tlog", mavlink))
    first, last = track.span_s
    assert (first, last) == pytest.approx((1.7e9 + 50.0, 1.7e9 + 50.0 + 0.05 * 156), abs=2e-3)
    pose = track.at(1.7e9 + 52.0)
    assert pose is not None
    assert pose.position_m == pytest.approx((3.0, 0.02 * 40, -7.5), abs=1e-3)
    # north, east, down and forward, starboard, down: roll stays, pitch and yaw are the other way
    angles = (pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
    assert angles == pytest.approx((0.1, 0.2, math.pi / 2 - 0.4), abs=1e-3)


def test_the_real_dive_against_what_is_known_of_it() -> None:
    pytest.importorskip("pymavlink")
    path = DATA / "ardusub_dive.tlog"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    track = read_poses(path)
    first, last = track.span_s
    assert first == pytest.approx(1683219851.591 + 689.37, abs=0.1)
    assert last - first == pytest.approx(952.750 - 689.345, abs=0.2)
    assert 5000 < len(track) < 5245
    poses = [track.sample(number) for number in range(len(track))]
    assert max(abs(pose.z_m) for pose in poses) < 0.35
    assert all(-0.69 <= pose.y_m <= 0.96 for pose in poses)  # north
    yaws = [math.degrees(math.remainder(math.pi / 2 - pose.yaw_rad, math.tau)) for pose in poses]
    shown = CliRunner().invoke(app, ["info", str(path)]).stdout
    assert "2023-05-04 17:15:4" in shown and "poses and no pings" in shown
    with pytest.raises(RecordingError, match="--poses"):
        open_recording(path)
    assert min(yaws) == pytest.approx(-167.0, abs=0.5) and max(yaws) == pytest.approx(
        -118.9, abs=0.5
    )


def test_telemetry_that_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pymavlink")
    junk = _file(tmp_path, "j.tlog", np.random.default_rng(0).bytes(5000))
    with pytest.raises(RecordingError, match=r"j\.tlog"):
        read_poses(junk)
    with pytest.raises(RecordingError, match="no such telemetry"):
        read_poses(tmp_path / "none.tlog")
    monkeypatch.setitem(sys.modules, "pymavlink.mavutil", None)
    with pytest.raises(MissingExtraError, match=r"insonify\[mavlink\]"):
        read_poses(junk)


def test_a_real_3d_sonar_against_its_makers_own_points(tmp_path: Path) -> None:
    """Each point lies in an occupied voxel, water lies before it, and no echo says nothing."""
    wlsonar = pytest.importorskip("wlsonar")
    rip = pytest.importorskip("wlsonar.range_image_protocol")
    path = DATA / "wl3d15_ship_short.sonar"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    recording = open_recording(path)
    assert recording.count == 6 * 256 and recording.facts["range_images"] == 6
    first = [one.ping for one in recording][:256]
    with path.open("rb") as file:
        message = rip.unpack(file)
    told = wlsonar.range_image_to_xyz(message)
    points = np.array([[x, -y, -z] for x, y, z in filter(None, told)])  # forward, left, up
    mapper = make_mapper("bayes", MappingSettings(voxel_m=0.1))
    for ping in first:
        mapper.integrate(ping, Pose(0.0, 0.0, -10.0))
    window = mapper.voxels.window(Box((0.0, -9.0, -15.0), (14.0, 9.0, -5.0)))

    def at(places: Any) -> Any:
        index = np.floor((places - np.array([0.0, 0.0, 10.0])) / 0.1).astype(int) - window.first
        return window.log_odds[tuple(index.T)]

    assert (at(points) > 0.0).mean() > 0.9  # but for edges that another ray passes
    before = at(0.5 * points)  # a voxel that an unknown direction crosses too stays unknown
    assert (before <= 0.0).mean() > 0.96 and (before < 0.0).mean() > 0.4
    heard = np.array([point is not None for point in told]).reshape(message.height, message.width)
    alone = np.argwhere(~maximum_filter(heard, 7))  # whose neighbours heard nothing either
    assert len(alone) > 200
    up = np.radians((alone[:, 0] / (message.height - 1) - 0.5) * message.fov_vertical)
    yaw = np.radians((0.5 - alone[:, 1] / (message.width - 1)) * message.fov_horizontal)
    away = np.stack([np.cos(up) * np.cos(yaw), np.cos(up) * np.sin(yaw), np.sin(up)], axis=1)
    assert (at(3.0 * away) == 0.0).all()


def test_a_3d_recording_that_is_damaged_or_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rip = pytest.importorskip("wlsonar.range_image_protocol")
    message = rip.RangeImage(
        range=5.0, width=4, height=3, fov_horizontal=30.0, fov_vertical=20.0,
        image_pixel_scale=0.001, speed_of_sound=1500.0, image_pixel_data=[0, 2000] * 6,
    )  # fmt: skip
    packet = rip.packb(message)
    path = _file(tmp_path, "a.sonar", 2 * packet)
    assert open_recording(path).count == 8
    ping = next(iter(open_recording(path))).ping
    assert np.isnan(ping.image).all()  # the first column heard nothing
    with pytest.warns(RecordingWarning, match="damaged or cut off"):
        assert open_recording(_file(tmp_path, "c.sonar", packet + packet[:-5])).count == 4
    with pytest.raises(RecordingError, match="--beams"):
        open_recording(path, Reading(beams="port-to-starboard"))
    monkeypatch.setitem(sys.modules, "wlsonar.range_image_protocol", None)
    with pytest.raises(MissingExtraError, match=r"insonify\[waterlinked\]"):
        open_recording(path)
