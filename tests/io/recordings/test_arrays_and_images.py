"""Archives, image folders, pose files, and the even fan they become."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import samples
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation, Slerp

from insonify.errors import ConfigError, RecordingError
from insonify.frames import transform_from_pose
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.beams import PixelError, even_fan, unit_pixels
from insonify.io.recordings.poses import PoseTrack, read_poses
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.sonar.devices import SonarDevice, named_device
from insonify.types import FanGeometry, Ping, Pose, PosedPing

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "recordings"
FAN = {"range_min_m": 0.5, "range_max_m": 3.0, "azimuth_deg": 60.0, "elevation_deg": 12.0}


def test_arrays_come_back_as_they_were(tmp_path: Path, rng: np.random.Generator) -> None:
    mount = Pose(0.2, 0.0, -0.1, 0.01, 0.5, -0.02)
    fan = FanGeometry(math.radians(50.0), math.radians(20.0), 6, 5, 0.1, 2.0, mount)
    pings = [
        PosedPing(
            Ping(rng.random((5, 6), np.float32), fan, 10.0 + k), Pose(k, 2.0, -3.0, 0.1, 0.2, 0.3)
        )
        for k in range(4)
    ]
    save_arrays(tmp_path / "r.npz", pings)
    recording = open_recording(tmp_path / "r.npz")
    assert recording.timed
    for before, after in zip(pings, recording, strict=True):
        np.testing.assert_array_equal(after.ping.image, before.ping.image)
        assert after.ping.time_s == before.ping.time_s
        assert after.pose == before.pose
        assert after.ping.geometry.mount == mount
        assert after.ping.geometry.azimuth_fov_rad == pytest.approx(fan.azimuth_fov_rad)


def test_the_turtles_columns_run_from_starboard_to_port_and_its_sonar_is_rolled() -> None:
    """As the sonar rises, what it sees must sink: see docs/recordings.md."""
    path = DATA / "holoocean_turtle.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    pings = list(open_recording(path))
    assert len(pings) == 60
    heights, middles = [], []
    for recorded in pings:
        assert recorded.pose is not None
        assert math.degrees(recorded.pose.roll_rad) == pytest.approx(90.0, abs=1e-3)
        # the brightest part, from 1.5 to 1.7 m; the sonar's left is the world's up
        near = recorded.ping.image[116:132].sum(axis=0)
        azimuths = recorded.ping.geometry.beam_azimuths_rad
        heights.append(recorded.pose.z_m)
        middles.append(float(near @ azimuths / near.sum()))
    slope = np.polyfit(heights, middles, 1)[0]
    # a thing 1.6 m ahead sinks by 1/1.6 rad for each metre that the sonar rises
    assert slope == pytest.approx(-1.0 / 1.6, rel=0.35)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": np.zeros((2, 3), np.uint8)}, "images"),
        ({"images": np.zeros((2, 3, 4), np.complex128)}, "images"),
        ({"range_max_m": 0.1}, "makes no sense"),
        ({"range_max_m": np.array([1.0, 2.0])}, "not one number"),
        ({"azimuth_deg": np.nan}, "not one number"),
        ({"time_s": np.zeros(3)}, "time_s"),
        ({"pose_body": np.zeros((2, 5))}, "pose_body"),
        ({"pose_body": np.full((2, 6), np.nan)}, "not finite"),
        ({"pose_sensor": np.zeros((2, 4, 4))}, "last row"),
        ({"pose_sensor": np.tile(np.diag([2.0, 1.0, 1.0, 1.0]), (2, 1, 1))}, "rigid"),
        ({"pose_sensor": np.stack([np.diag([1.0, 1.0, -1.0, 1.0])] * 2)}, "mirrored"),
        ({"pose_sensor": np.zeros((3, 4, 4))}, "one pose for each"),
        ({"images": np.array([[[None]]])}, "damaged"),
    ],
)
def test_archives_that_are_no_recording(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    good: dict[str, object] = {"images": np.zeros((2, 3, 4), np.uint8), **FAN}
    np.savez(tmp_path / "r.npz", **(good | change))  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match=words):
        list(open_recording(tmp_path / "r.npz"))


def test_arrays_larger_than_memory_are_refused_before_they_are_made(tmp_path: Path) -> None:
    honest = np.lib.format.header_data_from_array_1_0(np.zeros((1, 3, 4), np.uint8))
    honest["shape"] = (1 << 30, 1000, 1000)
    with (
        zipfile.ZipFile(tmp_path / "r.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("images.npy", "w") as stream,
    ):
        np.lib.format.write_array_header_2_0(stream, honest)
        stream.write(bytes(1 << 20))
    with pytest.raises(RecordingError, match="does not fit into"):
        open_recording(tmp_path / "r.npz")


def test_a_missing_figure_is_taken_from_the_sonar_or_asked_for(tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", images=np.zeros((2, 3, 4), np.uint8))
    with pytest.raises(RecordingError, match=r"no `range_min_m` .*--sonar"):
        open_recording(tmp_path / "r.npz")
    (recorded, _) = open_recording(tmp_path / "r.npz", Reading(SonarDevice(tilt_deg=10.0)))
    assert recorded.ping.geometry.range_max_m == 12.825
    assert recorded.ping.geometry.tilt_rad == pytest.approx(math.radians(10.0))


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    (tmp_path / "p.pkl").write_bytes(b"\x80\x04\x95\x00")
    with pytest.raises(RecordingError, match="pickle"):
        open_recording(tmp_path / "p.pkl")


@pytest.mark.parametrize("kind", ["png", "tif", "pgm"])
def test_a_folder_of_images_with_a_pose_each(
    tmp_path: Path, rng: np.random.Generator, kind: str
) -> None:
    images = samples.pixels(rng, 3, 8, 6)
    samples.image_folder(tmp_path / "f", images, samples.tum_rows(3), kind=kind)
    recording = open_recording(tmp_path / "f")
    pings = list(recording)
    assert not recording.timed and len(pings) == 3
    np.testing.assert_allclose(pings[2].ping.image, images[2] / 255, atol=1e-6)
    assert pings[2].pose is not None
    assert pings[2].pose.yaw_rad == pytest.approx(math.pi / 2)
    assert pings[0].ping.geometry.tilt_rad == pytest.approx(math.radians(15.0))


def test_images_named_by_their_times_take_interpolated_poses(tmp_path: Path) -> None:
    images = np.zeros((3, 8, 6), np.uint8)
    samples.image_folder(tmp_path / "f", images, samples.tum_rows(5))
    for number, time_s in enumerate((100.25, 101.5, 110.0)):
        (tmp_path / "f" / f"{number:04d}.png").rename(tmp_path / "f" / f"{time_s}.png")
    poses = [recorded.pose for recorded in open_recording(tmp_path / "f")]
    assert poses[0] is not None and poses[0].x_m == pytest.approx(0.025)
    assert poses[1] is not None and poses[1].x_m == pytest.approx(0.15)
    assert poses[2] is None
    late = open_recording(tmp_path / "f", Reading(clock_offset_s=1.0))
    pose = next(iter(late)).pose
    assert pose is not None and pose.x_m == pytest.approx(0.125)


def test_folders_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no images"):
        open_recording(tmp_path)
    samples.image_folder(tmp_path / "f", np.zeros((2, 4, 4), np.uint8), samples.tum_rows(3))
    with pytest.raises(RecordingError, match="needs as many poses"):
        open_recording(tmp_path / "f")
    (tmp_path / "f/poses.csv").unlink()
    (tmp_path / "f/0001.png").write_bytes(b"\x89PNG\r\n")
    with pytest.warns(RecordingWarning, match=r"0001\.png: cannot be read.*left out"):
        assert len(list(open_recording(tmp_path / "f"))) == 1
    (tmp_path / "f/sonar.toml").write_text("beams = 'many'")
    with pytest.raises(ConfigError, match="beams"):
        open_recording(tmp_path / "f")
    (tmp_path / "f/sonar.toml").unlink()
    with pytest.raises(RecordingError, match="--sonar"):
        open_recording(tmp_path / "f")


def test_a_sonar_is_named_or_described_in_a_file(tmp_path: Path) -> None:
    assert named_device("park-2025").beams == 96
    (tmp_path / "mine.toml").write_text("beams = 12\n")
    assert named_device(str(tmp_path / "mine.toml")).name == "mine"
    with pytest.raises(ConfigError, match=r"nor\.toml"):
        named_device("nor.toml")


def test_poses_turn_evenly_between_samples(rng: np.random.Generator) -> None:
    turns = Rotation.random(4, rng=rng)
    times = np.array([0.0, 1.0, 2.5, 3.0])
    rows = np.column_stack([times, rng.normal(size=(4, 3)), turns.as_quat()])
    track = PoseTrack(rows)
    reference = Slerp(times, turns)
    for time_s in rng.uniform(0.0, 3.0, 50):
        pose = track.at(float(time_s))
        assert pose is not None
        np.testing.assert_allclose(
            transform_from_pose(pose)[:3, :3], reference(time_s).as_matrix(), atol=1e-9
        )
        assert pose.x_m == pytest.approx(np.interp(time_s, times, rows[:, 1]))
    assert track.at(-0.1) is None and track.at(3.1) is None


def test_between_samples_poses_are_off_by_what_lies_between() -> None:
    rows = np.column_stack([[0.0, 1.0], np.zeros((2, 6)), np.ones(2)])
    track = PoseTrack(rows, std=np.array([[0.1, 0.0], [0.3, 0.02]]))
    for time_s, std in ((0.0, (0.1, 0.0)), (0.25, (0.15, 0.005)), (1.0, (0.3, 0.02))):
        pose = track.at(time_s)
        assert pose is not None
        assert pose.std == pytest.approx(std)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no poses"),
        ("# only\n", "no poses"),
        ("1 2 3\n", "3 numbers"),
        ("1 2 3 4 0 0 0 x\n", "not a number"),
        ("1 2 3 4 0 0 0 0\n", "quaternion 1"),
        ("1 2 3 nan 0 0 0 1\n", "not finite"),
        ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "go back"),
    ],
)
def test_pose_files_that_are_none(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "p.txt").write_text(text)
    with pytest.raises(RecordingError, match=words):
        read_poses(tmp_path / "p.txt")
    (tmp_path / "p.txt").write_text("time,x,y,z,qx,qy,qz,qw\n1,2,3,4,0,0,0,1\n")
    assert read_poses(tmp_path / "p.txt").sample(0) == Pose(2.0, 3.0, 4.0)


@given(
    steps=st.lists(st.floats(0.2, 3.0), min_size=2, max_size=40),
    start=st.floats(-40.0, 40.0),
)
def test_every_beam_of_the_even_fan_is_the_devices_nearest(
    steps: list[float], start: float
) -> None:
    bearings = np.radians(start + np.cumsum(steps))
    fan = even_fan(-bearings, np.arange(1.0, 6.0), 0.2, Pose(0.0, 0.0, 0.0))
    geometry = fan.geometry
    azimuths = geometry.beam_azimuths_rad + geometry.mount.yaw_rad
    numbers = fan.image(np.tile(np.arange(len(bearings), dtype=np.float32) / 100, (5, 1)))[0]
    nearest = np.argmin(abs(azimuths[:, None] + bearings), axis=1)
    distance = abs(azimuths[:, None] + bearings)
    taken = np.round(numbers * 100).astype(int)
    slack = np.take_along_axis(distance, taken[:, None], 1)[:, 0] - distance.min(axis=1)
    even = fan.beams is None
    assert slack.max() <= (0.1 * geometry.beam_rad if even else 1e-9)
    assert (taken == nearest).mean() > 0.4


def test_pixels_are_scaled_by_their_type() -> None:
    assert unit_pixels(np.array([[65535]], np.uint16)).item() == 1.0
    assert unit_pixels(np.array([[4095]], np.uint16), 4095.0).item() == 1.0
    assert unit_pixels(np.array([[255.0, 51.0]]), 255.0).tolist() == [[1.0, np.float32(0.2)]]
    assert unit_pixels(np.array([[1.00001, -0.00001]])).tolist() == [[1.0, 0.0]]  # of rounding
    for pixels, words in (([[255.0, 0.0]], "up to 255, above the full scale of 1.*--scale"),
                          ([[-40.0, 0.5]], "down to -40.*decibels")):  # fmt: skip
        with pytest.raises(PixelError, match=words):
            unit_pixels(np.array(pixels))
    with pytest.raises(PixelError, match="up to 4096, above the full scale of 4095"):
        unit_pixels(np.array([[4096]], np.uint16), 4095.0)
    with pytest.raises(ValueError, match="not a number"):
        unit_pixels(np.array([[np.nan]]))


def test_a_gap_between_poses_says_nothing_of_the_time_within() -> None:
    times = [*range(11), 110.0, 111.0]
    rows = np.array([[t, 0.1 * t, 0.0, -5.0, 0.0, 0.0, 0.0, 1.0] for t in times])
    track = PoseTrack(rows)
    assert track.max_gap_s == 5.0
    assert track.at(50.0) is None and track.at(10.0) is not None
    inside = track.at(110.5)
    assert inside is not None and inside.x_m == pytest.approx(11.05)
    longer = PoseTrack(rows, 100.0).at(50.0)
    assert longer is not None and longer.x_m == pytest.approx(5.0)
    assert PoseTrack(rows[::10][:2]).at(5.0) is not None  # sparse throughout is no gap
    fast = np.array([[0.01 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0] for k in (0, 1, 2, 3, 60, 200)])
    assert PoseTrack(fast).at(0.3) is not None and PoseTrack(fast).at(1.5) is None


def _images_folder(tmp_path: Path, *pictures: Image.Image) -> Path:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for number, picture in enumerate(pictures):
        picture.save(folder / f"{number}.png")
    (folder / "sonar.toml").write_text("azimuth_fov_deg = 60.0\nrange_max_m = 5.0\n")
    return folder


def test_colours_do_not_say_how_loud_an_echo_was(tmp_path: Path, rng: np.random.Generator) -> None:
    grey = rng.integers(0, 256, (8, 6), dtype=np.uint8)
    three = Image.fromarray(np.repeat(grey[..., None], 3, axis=2))
    folder = _images_folder(tmp_path, Image.fromarray(grey), three, three.convert("RGBA"))
    for recorded in open_recording(folder):
        np.testing.assert_allclose(recorded.ping.image, grey / 255, atol=1e-6)
    coloured = np.stack([grey, grey // 2, 255 - grey], axis=2)
    Image.fromarray(coloured).save(folder / "0.png")
    with pytest.raises(RecordingError, match=r"0\.png: a picture in colours .*in grey"):
        open_recording(folder)


def test_matrices_and_angles_that_cannot_be_meant_are_refused(tmp_path: Path) -> None:
    pose = Pose(1.0, 2.0, -3.0, 0.1, 0.2, 0.3)
    matrix = transform_from_pose(pose)
    fan: Any = {"range_min_m": 0.1, "range_max_m": 5.0, "azimuth_deg": 60.0, "elevation_deg": 20.0}
    images = np.zeros((1, 8, 6), np.uint8)
    path = tmp_path / "r.npz"
    np.savez(path, images=images, pose_sensor=matrix[None], **fan)
    (recorded,) = open_recording(path)
    assert recorded.pose is not None and recorded.pose.position_m == pytest.approx((1, 2, -3))
    np.savez(path, images=images, pose_sensor=matrix.T[None], **fan)
    with pytest.raises(RecordingError, match=r"last row .* transposed"):
        open_recording(path)
    np.savez(path, images=images, pose_body=np.array([[0, 0, 0, 0, 0, 90.0]]), **fan)
    with pytest.raises(RecordingError, match=r"an angle of 90, .*degrees"):
        open_recording(path)


def test_no_pose_is_made_up_where_the_vehicle_jumps() -> None:
    """At rest, then 50 m away a tenth of a second later; what the user says is taken as it is."""
    rows = np.zeros((40, 8))
    rows[:, 0], rows[20:, 1], rows[:, 7] = 0.1 * np.arange(40), 50.0, 1.0
    track = PoseTrack(rows)
    assert track.at(1.95) is None and track.at(1.85) is not None and track.at(2.05) is not None
    given = PoseTrack(rows, 1.0).at(1.95)
    assert given is not None and given.x_m == pytest.approx(25.0)
    steady = PoseTrack(
        np.column_stack([np.arange(9.0), 20.0 * np.arange(9.0), np.zeros((9, 5)), np.ones(9)])
    )
    assert steady.at(3.5) is not None  # fast, and always so


def test_what_an_archive_says_is_taken_or_refused(tmp_path: Path) -> None:
    """Columns by any spelling, poses at other times, a mount that nobody tells."""
    images = np.zeros((5, 8, 4), np.uint8)
    images[:, 3, 0] = 255
    sizes = {"range_min_m": 0.0, "range_max_m": 4.0, "azimuth_deg": 40.0, "elevation_deg": 9.0}
    body = np.zeros((5, 6))
    body[:, 0] = np.arange(5.0)

    def archive(**more: object) -> Path:
        np.savez(tmp_path / "a.npz", images=images, pose_body=body, **sizes, **more)  # type: ignore[arg-type]
        return tmp_path / "a.npz"

    for columns in ("starboard-to-port", "starboard to port", "STARBOARD_TO_PORT"):
        (first, *_) = open_recording(archive(columns=columns))
        assert first.ping.image[3, 3] == 1.0
    with pytest.raises(RecordingError, match="left_to_right"):
        open_recording(archive(columns="left_to_right"))
    path = archive(columns="port_to_starboard", time_s=np.arange(5.0))
    assert "where the sonar sits" in str(open_recording(path).facts["doubts"])
    late = list(open_recording(path, Reading(clock_offset_s=0.5)))
    assert [one.pose and one.pose.x_m for one in late] == [0.5, 1.5, 2.5, 3.5, None]
    with pytest.raises(RecordingError, match="no clock"):
        open_recording(archive(), Reading(clock_offset_s=0.5))
    poses = "".join(f"0 {x} 0 -5 0 0 0 1\n" for x in range(5))
    (tmp_path / "p.tum").write_text(poses)
    with pytest.raises(RecordingError, match="no clock"):  # also beside a file of poses
        open_recording(archive(), Reading(poses=tmp_path / "p.tum", clock_offset_s=0.5))
