"""Bags of ROS 1 and 2 as others write them, decoded from the definitions in them."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.bag_samples import KINDS, BagMaker, plain_bag
from PIL import Image
from scipy.spatial.transform import Rotation

from insonify.errors import RecordingError
from insonify.frames import transform_from_pose
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.io.recordings.ros.messages import IMAGE_FROM_SONAR
from insonify.sonar.devices import SonarDevice
from insonify.types import Pose

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
AZIMUTHS = np.radians([12.0, 4.0, -4.0, -12.0])
RANGES = 1.0 + 0.1 * np.arange(6)


def _mounted(maker: BagMaker, mount: Pose) -> tuple[str, float, Any]:
    """TF of the sonar's frame (z forward, x up) for a mount of ours."""
    transform = transform_from_pose(mount) @ IMAGE_FROM_SONAR
    quaternion = Rotation.from_matrix(transform[:3, :3]).as_quat()
    link = maker.link(0.0, "base_link", "sonar", transform[:3, 3], quaternion)
    return ("/tf_static", 0.0, link)


@pytest.mark.parametrize("kind", KINDS)
def test_pings_poses_and_mount_of_a_bag(
    tmp_path: Path, rng: np.random.Generator, kind: str
) -> None:
    maker = BagMaker(kind)
    mount = Pose(0.3, 0.0, -0.1, 0.0, 0.5, 0.0)
    image = rng.integers(0, 65536, (6, 4), dtype=np.uint16)
    half = np.array([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])
    messages = [
        _mounted(maker, mount),
        ("/odom", 10.0, maker.odometry(10.0, np.array([0.0, 0.0, -5.0]), LEVEL)),
        # beams from starboard to port: the reader puts them in order
        ("/s", 10.5, maker.projected(10.5, image[:, ::-1], AZIMUTHS[::-1], RANGES, 0.2)),
        ("/s", 11.5, maker.projected(11.5, image, AZIMUTHS, RANGES, 0.2)),
        ("/odom", 11.0, maker.odometry(11.0, np.array([2.0, 1.0, -5.0]), half)),
    ]
    messages.sort(key=lambda message: message[1])
    recording = open_recording(maker.write(tmp_path / "b", messages))
    first, second = recording
    np.testing.assert_allclose(first.ping.image, image / 65535, atol=1e-6)
    np.testing.assert_allclose(second.ping.image, image / 65535, atol=1e-6)
    fan = first.ping.geometry
    assert fan.range_min_m == pytest.approx(0.95) and fan.range_max_m == pytest.approx(1.55)
    assert math.degrees(fan.azimuth_fov_rad) == pytest.approx(32.0)
    assert fan.elevation_fov_rad == pytest.approx(0.2)
    np.testing.assert_allclose(
        transform_from_pose(fan.mount), transform_from_pose(mount), atol=1e-9
    )
    assert first.pose is not None and second.pose is None  # no odometry after it
    assert first.pose.position_m == pytest.approx((1.0, 0.5, -5.0))
    assert math.degrees(first.pose.yaw_rad) == pytest.approx(45.0)
    late = next(iter(open_recording(recording.path, Reading(clock_offset_s=0.25))))
    assert late.pose is not None and late.pose.x_m == pytest.approx(1.5)


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_poses_from_tf_alone(tmp_path: Path, kind: str) -> None:
    maker = BagMaker(kind)
    image = np.zeros((6, 4), np.uint8)
    messages = [_mounted(maker, Pose(0.0, 0.0, 0.0))]
    for time_s, x in ((0.0, 0.0), (2.0, 4.0)):
        position = np.array([x, 0.0, 0.0])
        messages.append(("/tf", time_s, maker.link(time_s, "map", "odom", position / 2, LEVEL)))
        messages.append(("/tf", time_s, maker.link(time_s, "odom", "base_link", position, LEVEL)))
    messages.append(("/s", 1.0, maker.projected(1.0, image, AZIMUTHS, RANGES, 0.2)))
    messages.sort(key=lambda message: message[1])
    (recorded,) = open_recording(maker.write(tmp_path / "b", messages))
    assert recorded.pose is not None and recorded.pose.x_m == pytest.approx(3.0)
    assert recorded.ping.geometry.mount.position_m == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize("kind", ["db3", "ros1"])
def test_oculus_pings_are_decoded_from_the_bags_own_definition(
    tmp_path: Path, rng: np.random.Generator, kind: str
) -> None:
    maker = BagMaker(kind)
    image = rng.integers(0, 256, (9, 5), dtype=np.uint8)
    packed = io.BytesIO()
    Image.fromarray(image).save(packed, "png")
    ping = maker.new(
        "sonar_oculus/OculusPing", header=maker.header(3.0, "sonar"), ping_id=1,
        range_resolution=0.02, num_ranges=9, num_beams=5,
        bearings=np.array([-2000, -1000, 0, 1000, 2000], np.int16),
        ping=maker.new("sensor_msgs/CompressedImage", header=maker.header(3.0, ""), format="png",
                       data=np.frombuffer(packed.getvalue(), np.uint8)),
    )  # fmt: skip
    plain = maker.new(
        "other_driver/Fan", header=maker.header(3.0, "sonar"), range_resolution=0.02,
        num_ranges=9, bearings=np.radians([-20, -10, 0, 10, 20]).astype(np.float32),
        ping=maker.new("sensor_msgs/Image", header=maker.header(3.0, ""), height=9, width=5,
                       encoding="mono8", is_bigendian=0, step=5, data=image.reshape(-1)),
    )  # fmt: skip
    path = maker.write(tmp_path / "b", [("/a", 3.0, ping), ("/b", 3.0, plain)])
    with pytest.raises(RecordingError, match=r"--sonar-topic.*/a, /b"):
        open_recording(path)
    for topic in ("/a", "/b"):
        device = SonarDevice(elevation_fov_deg=12.0, tilt_deg=5.0)
        (recorded,) = open_recording(path, Reading(device, sonar_topic=topic))
        np.testing.assert_allclose(recorded.ping.image, image / 255, atol=1e-6)
        fan = recorded.ping.geometry
        assert math.degrees(fan.azimuth_fov_rad) == pytest.approx(50.0, abs=1e-4)
        assert fan.bin_m == pytest.approx(0.02) and fan.range_min_m == pytest.approx(0.0)
        assert math.degrees(fan.tilt_rad) == pytest.approx(5.0)
    assert open_recording(path, Reading(sonar_topic="/a")).facts["elevation_assumed"]


def test_a_ping360_is_one_beam_that_turns(tmp_path: Path) -> None:
    maker = BagMaker("mcap")
    echo = np.arange(50, dtype=np.uint8)
    messages = [
        ("/echo", 1.0 + k, maker.new(
            "ping360_sonar_msgs/SonarEcho", header=maker.header(1.0 + k, "sonar"),
            angle=k * math.pi / 2, gain=1, number_of_samples=50, transmit_frequency=750,
            speed_of_sound=1500, range=10, intensities=echo,
        ))
        for k in range(4)
    ]  # fmt: skip
    pings = [recorded.ping for recorded in open_recording(maker.write(tmp_path / "b", messages))]
    turns = [math.remainder(p.geometry.mount.yaw_rad - k * math.pi / 2, math.tau)
             for k, p in enumerate(pings)]  # fmt: skip
    assert turns == pytest.approx([0.0] * 4, abs=1e-6)
    assert pings[0].image.shape == (50, 1)
    assert pings[0].geometry.range_max_m == pytest.approx(10.0)
    assert pings[0].geometry.bin_m == pytest.approx(0.2)


def test_bags_that_are_no_recording(tmp_path: Path, rng: np.random.Generator) -> None:
    maker = BagMaker("mcap")
    odometry = maker.odometry(1.0, np.zeros(3), LEVEL)
    path = maker.write(tmp_path / "b", [("/odom", 1.0, odometry)])
    with pytest.raises(RecordingError, match=r"no pings .*/odom \(nav_msgs"):
        open_recording(path)
    good = plain_bag(tmp_path / "good", "mcap", rng)
    with pytest.raises(RecordingError, match="no pings on /nor"):
        open_recording(good, Reading(sonar_topic="/nor"))
    with pytest.raises(RecordingError, match="no poses on /nor; topics of poses: /odom"):
        open_recording(good, Reading(pose_topic="/nor"))


def test_a_ping_whose_size_is_wrong_is_left_out(tmp_path: Path) -> None:
    maker = BagMaker("mcap")
    good = maker.projected(1.0, np.zeros((6, 4), np.uint8), AZIMUTHS, RANGES, 0.2)
    bad = maker.projected(2.0, np.zeros((6, 4), np.uint8), AZIMUTHS, RANGES[:-1], 0.2)
    path = maker.write(tmp_path / "b", [("/s", 1.0, good), ("/s", 2.0, bad)])
    recording = open_recording(path)
    with pytest.warns(RecordingWarning, match="1 messages of /s are no pings"):
        assert len(list(recording)) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_cut_off_is_read_up_to_there_or_refused(
    tmp_path: Path, rng: np.random.Generator, kind: str
) -> None:
    path = plain_bag(tmp_path / "b", kind, rng, pings=40)
    file = next(path.glob("*.db3")) if path.is_dir() else path
    raw = file.read_bytes()
    file.write_bytes(raw[: len(raw) // 2])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            count = len(list(open_recording(path)))
        except RecordingError as err:
            assert "damaged" in str(err)
        else:
            assert 0 < count < 40
            assert "cut off" in str(told[0].message)


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_a_message_without_a_pose_leaves_itself_out(tmp_path: Path, kind: str) -> None:
    maker = BagMaker(kind)
    image = np.zeros((6, 4), np.uint8)
    messages = []
    for k in range(11):
        turn = np.zeros(4) if k == 3 else LEVEL
        place = np.array([np.nan if k == 7 else 0.5 * k, 0.0, -5.0])
        messages.append(("/odom", float(k), maker.odometry(float(k), place, turn)))
        messages.append(("/s", k + 0.5, maker.projected(k + 0.5, image, AZIMUTHS, RANGES, 0.2)))
    path = maker.write(tmp_path / "b", messages)
    with pytest.warns(RecordingWarning, match="2 messages of /odom hold no pose"):
        pings = list(open_recording(path))
    poses = [recorded.pose for recorded in pings]
    assert [pose is None for pose in poses] == [False] * 10 + [True]
    assert poses[3] is not None and poses[3].x_m == pytest.approx(1.75)
