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
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.sonar.devices import SonarDevice
from insonify.types import Pose

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
AZIMUTHS = np.radians([12.0, 4.0, -4.0, -12.0])
RANGES = 1.0 + 0.1 * np.arange(6)


def _mounted(
    maker: BagMaker, mount: Pose, topic: str = "/tf_static", time_s: float = 0.0,
    base: str = "base_link", frame: str = "sonar",
) -> tuple[str, float, Any]:  # fmt: skip
    """TF of the sonar's frame (z forward, x up) for a mount of ours."""
    transform = transform_from_pose(mount) @ IMAGE_FROM_SONAR
    quaternion = Rotation.from_matrix(transform[:3, :3]).as_quat()
    link = maker.link(time_s, base, frame, transform[:3, 3], quaternion)
    return (topic, time_s, link)


def _spotted(maker: BagMaker, frame: str = "sonar", topic: str = "/s") -> list[Any]:
    """Ten pings at t + 0.5 s that show a spot 5 m straight ahead, and a vehicle at rest."""
    azimuths, ranges = np.radians(np.linspace(29.5, -29.5, 60)), 0.05 + 0.1 * np.arange(100)
    image = np.zeros((100, 60), np.uint8)
    image[48:51, 29:32] = 255
    return [
        (topic, k + 0.5, maker.projected(k + 0.5, image, azimuths, ranges, 0.2, frame))
        for k in range(10)
    ]


def _resting(maker: BagMaker, topic: str, place: Any, child: str = "base_link") -> list[Any]:
    return [
        (topic, float(k), maker.odometry(float(k), np.array(place), LEVEL, child))
        for k in range(11)
    ]


def _spot_m(path: Path, reading: Reading = Reading()) -> list[float]:
    """Where the spot lands in the map."""
    remap = map_recordings([open_recording(path, reading)], MappingSettings())
    middle = remap.mapper.voxels.occupied_m().mean(axis=0)
    return [float(c) for c in middle]


def _bag(maker: BagMaker, path: Path, messages: list[Any]) -> Path:
    return maker.write(path, sorted(messages, key=lambda message: message[1]))


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
@pytest.mark.parametrize("child", ["base_link", "bluerov2/base_link"])
def test_a_mount_that_tf_tells_again_and_again(tmp_path: Path, kind: str, child: str) -> None:
    maker = BagMaker(kind)
    aside = Pose(0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2)
    messages = _spotted(maker) + _resting(maker, "/odom", [0.0, 0.0, -5.0], child)
    messages += [_mounted(maker, aside, "/tf", 0.5 * k) for k in range(21)]
    path = _bag(maker, tmp_path / "b", messages)
    assert _spot_m(path) == pytest.approx([0.0, 5.0, -5.0], abs=0.1)
    facts = open_recording(path).facts
    assert facts["poses"] == f"11 on /odom, whose frame {child} carries the sonar"
    assert facts["mount"] == "TF, moving" and not facts["doubts"]


def test_a_head_that_pans_is_where_it_is_at_each_ping(tmp_path: Path) -> None:
    maker = BagMaker("mcap")
    messages = _spotted(maker) + _resting(maker, "/odom", [0.0, 0.0, -5.0])
    for k in range(11):
        head = Pose(0.2, 0.0, 0.0, 0.0, 0.0, math.radians(9.0 * k))
        messages.append(_mounted(maker, head, "/tf", float(k)))
    recording = open_recording(_bag(maker, tmp_path / "b", messages))
    yaws = [math.degrees(recorded.ping.geometry.mount.yaw_rad) for recorded in recording]
    assert yaws == pytest.approx([9.0 * k + 4.5 for k in range(10)], abs=1e-6)


@pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning")
@pytest.mark.parametrize(
    ("base", "words"),
    [("camera_rig", "TF does not join its frame 'sonar' to the vehicle's 'base_link'"),
     ("", "its frame 'sonar' is not in TF")],
)  # fmt: skip
def test_a_mount_that_is_not_known_is_told(tmp_path: Path, base: str, words: str) -> None:
    maker = BagMaker("mcap")
    messages = _spotted(maker) + _resting(maker, "/odom", [0.0, 0.0, -5.0])
    if base:
        messages.append(_mounted(maker, Pose(0.0, 0.0, 0.0), base=base))
    path = _bag(maker, tmp_path / "b", messages)
    recording = open_recording(path)
    with pytest.warns(RecordingWarning, match=words):
        result = map_recordings([recording], MappingSettings()).result().to_json()
    mount, axes = result["recordings"][0]["doubts"]
    assert words in mount and "z ahead, y to port, as is assumed" in axes
    device = SonarDevice(tilt_deg=0.0)
    assert not any(words in d for d in open_recording(path, Reading(device)).facts["doubts"])


def _tf(maker: BagMaker, x: float) -> list[Any]:
    place = np.array([x, 0.0, -5.0])
    return [
        ("/tf", float(k), maker.link(float(k), "odom", "base_link", place, LEVEL))
        for k in range(11)
    ]


def test_the_poses_are_those_of_the_vehicle_that_carries_the_sonar(tmp_path: Path) -> None:
    maker = BagMaker("mcap")
    goals = [("/goal_pose", float(k), maker.posed(float(k), np.zeros(3))) for k in range(11)]
    ahead = _mounted(maker, Pose(0.0, 0.0, 0.0))
    path = _bag(maker, tmp_path / "goal", [*_spotted(maker), *goals, ahead, *_tf(maker, 1.0)])
    assert _spot_m(path) == pytest.approx([6.0, 0.0, -5.0], abs=0.1)
    assert open_recording(path).facts["poses"] == "TF of base_link, up to odom"
    two = _resting(maker, "/auv1/odom", [50.0, 0.0, -5.0], "auv1/base_link")
    two += _resting(maker, "/auv2/odom", [2.0, 0.0, -5.0], "auv2/base_link")
    seen = _spotted(maker, "auv2/sonar", "/auv2/sonar/image")
    link = _mounted(maker, Pose(0.0, 0.0, 0.0), base="auv2/base_link", frame="auv2/sonar")
    path = _bag(maker, tmp_path / "two", [*seen, *two, link])
    assert _spot_m(path) == pytest.approx([7.0, 0.0, -5.0], abs=0.1)
    mavros = _resting(maker, "/mavros/global_position/local", [90.0, 0.0, -5.0])
    mavros += _resting(maker, "/mavros/local_position/odom", [3.0, 0.0, -5.0])
    path = _bag(maker, tmp_path / "mavros", [*_spotted(maker), *mavros, ahead])
    assert _spot_m(path) == pytest.approx([8.0, 0.0, -5.0], abs=0.1)
    assert _spot_m(path, Reading(pose_topic="/mavros/global_position/local")) == pytest.approx(
        [95.0, 0.0, -5.0], abs=0.1
    )


def test_where_several_topics_could_be_meant_the_user_says_which(tmp_path: Path) -> None:
    maker = BagMaker("mcap")
    several = _resting(maker, "/filter/a", [0.0, 0.0, -5.0])
    several += _resting(maker, "/filter/b", [1.0, 0.0, -5.0])
    ahead = _mounted(maker, Pose(0.0, 0.0, 0.0))
    path = _bag(maker, tmp_path / "b", [*_spotted(maker), *several, ahead])
    with pytest.raises(RecordingError, match=r"--pose-topic\): /filter/a, /filter/b"):
        open_recording(path)
    assert _spot_m(path, Reading(pose_topic="/filter/b")) == pytest.approx(
        [6.0, 0.0, -5.0], abs=0.1
    )


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
    assert "nominal 20 degrees" in str(open_recording(path, Reading(sonar_topic="/a")).facts)


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
    messages = [_mounted(maker, Pose(0.0, 0.0, 0.0))]
    for k in range(11):
        turn = np.zeros(4) if k == 3 else LEVEL
        place = np.array([np.nan if k == 7 else 0.5 * k, 0.0, -5.0])
        messages.append(("/odom", float(k), maker.odometry(float(k), place, turn)))
        messages.append(("/s", k + 0.5, maker.projected(k + 0.5, image, AZIMUTHS, RANGES, 0.2)))
    path = maker.write(tmp_path / "b", messages)
    recording = open_recording(path)
    (doubt,) = recording.facts["doubts"]
    assert "2 messages of /odom hold no pose" in doubt
    pings = list(recording)
    poses = [recorded.pose for recorded in pings]
    assert [pose is None for pose in poses] == [False] * 10 + [True]
    assert poses[3] is not None and poses[3].x_m == pytest.approx(1.75)


def test_tf_tells_poses_of_the_sonars_own_frame_alone(tmp_path: Path) -> None:
    """By the vehicle's name or without it; of a frame that is not there it tells none."""
    maker = BagMaker("mcap")
    ahead = _mounted(maker, Pose(0.0, 0.0, 0.0))
    named = _bag(maker, tmp_path / "a", [*_spotted(maker, "auv/sonar"), ahead, *_tf(maker, 1.0)])
    assert _spot_m(named) == pytest.approx([6.0, 0.0, -5.0], abs=0.1)
    other = _bag(maker, tmp_path / "b", [*_spotted(maker, "head"), ahead, *_tf(maker, 1.0)])
    pan = [_mounted(maker, Pose(0.0, 0.0, 0.0), "/tf", float(k)) for k in range(11)]
    alone = _bag(maker, tmp_path / "c", [*_spotted(maker), *pan])
    for path in (other, alone):
        assert open_recording(path).facts["poses"] == "none"
        with pytest.raises(RecordingError, match="none of its 10 pings has a pose"):
            map_recordings([open_recording(path)], MappingSettings())


SIDE = [5.0 * math.cos(math.radians(20.0)), 5.0 * math.sin(math.radians(20.0)), -5.0]
"""A spot 5 m away and 20 degrees to port, seen from 5 m under the water."""


def _aside(maker: BagMaker, directions: Any, azimuths: Any, frame: str = "sonar") -> list[Any]:
    """Pings with a spot 20 degrees to port, in a beam order and with directions of a driver's."""
    image = np.zeros((100, len(azimuths)), np.uint8)
    image[48:51, abs(azimuths - math.radians(20.0)) < 0.03] = 255
    pings = []
    for k in range(10):
        ping = maker.projected(k + 0.5, image, azimuths, 0.05 + 0.1 * np.arange(100), 0.05, frame)
        vectors = zip(*np.broadcast_arrays(*directions(azimuths)), strict=True)
        ping.beam_directions = [maker.vector(*vector) for vector in vectors]
        pings.append(("/s", k + 0.5, ping))
    return pings


TO_STARBOARD = np.radians(np.linspace(29.5, -29.5, 60))
DRIVERS = {
    "oculus_sonar_driver": (lambda a: (0.0, np.sin(a), np.cos(a)), TO_STARBOARD),
    "nps, dave": (lambda a: (np.cos(a), np.sin(a), 0.0), TO_STARBOARD[::-1]),
    "optical": (lambda a: (-np.sin(a), 0.0, np.cos(a)), TO_STARBOARD),
}


@pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning")
@pytest.mark.parametrize("driver", DRIVERS)
def test_beams_as_drivers_and_simulators_write_them(tmp_path: Path, driver: str) -> None:
    """Without TF the side is assumed, said, and can be overruled."""
    maker = BagMaker("mcap")
    directions, azimuths = DRIVERS[driver]
    messages = _aside(maker, directions, azimuths)
    path = _bag(maker, tmp_path / "b", messages + _resting(maker, "/odom", [0.0, 0.0, -5.0]))
    with pytest.warns(RecordingWarning, match="drivers differ"):
        assert _spot_m(path) == pytest.approx(SIDE, abs=0.15)
    other = "starboard-to-port" if azimuths[0] > 0.0 else "port-to-starboard"
    assert _spot_m(path, Reading(beams=other)) == pytest.approx([SIDE[0], -SIDE[1], -5.0], abs=0.15)
    assert "drivers differ" not in str(open_recording(path, Reading(beams=other)).facts["doubts"])


@pytest.mark.parametrize("seed", range(5))
def test_beams_in_any_frame_that_tf_tells(tmp_path: Path, seed: int) -> None:
    """Directions turned at random and a frame turned back by as much: the same map."""
    maker = BagMaker("mcap")
    turn = Rotation.random(random_state=seed)
    while abs((turn.inv().apply([1.0, 0.0, 0.0]))[1]) > 0.95:  # neither along x nor z: refused
        turn = Rotation.random(random_state=seed + 100)
    heading = turn.inv().apply([1.0, 0.0, 0.0])
    if max(heading[0], heading[2]) < 0.1:
        turn = turn * Rotation.from_euler("y", 180, degrees=True)

    def directions(a: Any) -> Any:
        return turn.inv().apply(np.stack([np.cos(a), np.sin(a), 0.0 * a], 1)).T

    messages = _aside(maker, directions, TO_STARBOARD)
    messages += _resting(maker, "/odom", [0.0, 0.0, -5.0])
    messages.append(
        ("/tf_static", 0.0, maker.link(0.0, "base_link", "sonar", np.zeros(3), turn.as_quat()))
    )
    path = _bag(maker, tmp_path / "b", messages)
    assert _spot_m(path) == pytest.approx(SIDE, abs=0.15)
    assert not open_recording(path).facts["doubts"]


def test_a_frame_that_tf_has_wrong_looks_up(tmp_path: Path) -> None:
    maker = BagMaker("mcap")
    link = maker.link(0.0, "base_link", "sonar", np.zeros(3), LEVEL)
    messages = _spotted(maker) + _resting(maker, "/odom", [0.0, 0.0, -5.0])
    path = _bag(maker, tmp_path / "b", [*messages, ("/tf_static", 0.0, link)])
    with pytest.warns(RecordingWarning, match="by TF its beams look up by 90 degrees"):
        assert _spot_m(path) == pytest.approx([0.0, 0.0, 0.0], abs=0.15)
    ahead = Reading(mount=Pose(0.0, 0.0, 0.0), beams="port-to-starboard")
    assert not open_recording(path, ahead).facts["doubts"]
    assert _spot_m(path, ahead) == pytest.approx([5.0, 0.0, -5.0], abs=0.15)


@pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning")
@pytest.mark.parametrize("joined", [True, False])
def test_axes_of_poses_by_the_names_of_frames(tmp_path: Path, joined: bool) -> None:
    """North 1, east 2, 5 m deep, heading east, and a mount that looks to starboard."""
    maker = BagMaker("mcap")
    east = Rotation.from_euler("z", 90.0, degrees=True).as_quat()
    messages = _spotted(maker)
    for k in range(11):
        message = maker.odometry(float(k), np.array([1.0, 2.0, 5.0]), east, "base_link_frd")
        message.header.frame_id = "odom_ned"
        messages.append(("/odom", float(k), message))
    reading = Reading(beams="port-to-starboard")
    expected = [7.0, 1.0, -5.0]
    if joined:  # z ahead, y to starboard, x up in forward, starboard, down: to starboard by 90
        frd_from_frame = np.stack([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 1)
        quaternion = Rotation.from_matrix(frd_from_frame).as_quat()
        link = maker.link(0.0, "base_link_frd", "sonar", np.zeros(3), quaternion)
        messages.append(("/tf_static", 0.0, link))
        expected = [2.0, -4.0, -5.0]
    path = _bag(maker, tmp_path / "b", messages)
    assert _spot_m(path, reading) == pytest.approx(expected, abs=0.15)
    facts = open_recording(path).facts
    assert "taken as north, east, down of a body forward, starboard, down" in facts["poses"]
    (first, *_) = open_recording(path)
    assert first.pose is not None
    assert [first.pose.x_m, first.pose.y_m, first.pose.z_m] == pytest.approx([2.0, 1.0, -5.0])
    assert [first.pose.roll_rad, first.pose.yaw_rad] == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("kind", ["/tf_static", "/tf"])
def test_the_mount_is_tfs_where_the_poses_are_a_files(tmp_path: Path, kind: str) -> None:
    """A bag without odometry, or with two that nobody asked for."""
    maker = BagMaker("mcap")
    aside = Pose(0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2)
    links = [_mounted(maker, aside, kind, 0.5 * k) for k in range(21 if kind == "/tf" else 1)]
    (tmp_path / "p.tum").write_text("".join(f"{t} 1 0 -5 0 0 0 1\n" for t in range(11)))
    reading = Reading(poses=tmp_path / "p.tum")
    path = _bag(maker, tmp_path / "b", _spotted(maker) + links)
    assert _spot_m(path, reading) == pytest.approx([1.0, 5.0, -5.0], abs=0.15)
    assert not open_recording(path, reading).facts["doubts"]
    others = _resting(maker, "/a", [9.0, 0.0, 0.0]) + _resting(maker, "/b", [7.0, 0.0, 0.0])
    path = _bag(maker, tmp_path / "c", _spotted(maker) + links + others)
    assert _spot_m(path, reading) == pytest.approx([1.0, 5.0, -5.0], abs=0.15)


def test_each_vehicle_has_its_own_tf(tmp_path: Path) -> None:
    """Frames of one name in the topics of two vehicles."""
    maker = BagMaker("mcap")
    left, right = (Pose(0.0, 0.0, 0.0, yaw_rad=side * math.pi / 2) for side in (1, -1))
    messages = [
        *_spotted(maker, "sonar", "/auv1/sonar"),
        *_resting(maker, "/auv1/odom", [0.0, 0.0, -5.0]),
        *_resting(maker, "/auv2/odom", [50.0, 0.0, -5.0]),
        _mounted(maker, left, "/auv1/tf_static"),
        _mounted(maker, right, "/auv2/tf_static", 0.1),
    ]
    path = _bag(maker, tmp_path / "b", messages)
    assert _spot_m(path) == pytest.approx([0.0, 5.0, -5.0], abs=0.15)


@pytest.mark.parametrize("driver", ["oculus_sonar_driver", "nps, dave"])
def test_a_mount_that_overrules_tf_leaves_the_side_to_it(tmp_path: Path, driver: str) -> None:
    """Told the mount that `info` prints, nothing changes; a head that turns is refused."""
    maker = BagMaker("mcap")
    directions, azimuths = DRIVERS[driver]
    ahead = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    turn = ahead if driver == "oculus_sonar_driver" else np.eye(3)
    quaternion = Rotation.from_matrix(turn).as_quat()
    messages = _aside(maker, directions, azimuths) + _resting(maker, "/odom", [0.0, 0.0, -5.0])
    link = maker.link(0.0, "base_link", "sonar", np.zeros(3), quaternion)
    path = _bag(maker, tmp_path / "b", [*messages, ("/tf_static", 0.0, link)])
    assert _spot_m(path) == pytest.approx(SIDE, abs=0.15)
    (first, *_) = open_recording(path)
    told = Reading(mount=first.ping.geometry.mount)
    assert _spot_m(path, told) == pytest.approx(SIDE, abs=0.15)
    moving = [("/tf", float(k), maker.link(float(k), "base_link", "sonar", np.zeros(3), quaternion))
              for k in range(11)]  # fmt: skip
    path = _bag(maker, tmp_path / "c", messages + moving)
    with pytest.raises(RecordingError, match="by TF the sonar turns"):
        open_recording(path, told)
