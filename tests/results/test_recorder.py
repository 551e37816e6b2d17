"""A scan recorded: other programs read it, and the map made of it is the scan's, bit for bit."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from insonify.io.maps import save_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.mcap_writing import McapWriter
from insonify.mapping.carving import CarvingMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.results.recorder import recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    folder = tmp_path_factory.mktemp("scan")
    quick = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 6}}
    with recording(folder) as record:
        run = execute(scenario_config("tetrapod", [quick]), watch=record)
    return run, folder / "recording.mcap"


def test_the_map_of_the_recording_is_the_scans_own(scan: tuple[Run, Path], tmp_path: Path) -> None:
    run, path = scan
    replay = map_recordings([open_recording(path)], run.config.mapping)
    save_map(run.mapper.voxels, tmp_path / "scan.npz")
    save_map(replay.mapper.voxels, tmp_path / "replay.npz")
    assert (tmp_path / "scan.npz").read_bytes() == (tmp_path / "replay.npz").read_bytes()
    assert replay.fans == [run.config.sonar.geometry]


def test_how_far_poses_may_be_off_is_recorded_too(tmp_path: Path) -> None:
    quick = {
        "mapper": "carving",
        "planner": "uniform",
        "mapping": {"voxel_m": 0.25},
        "survey": {"waypoints": 6},
        "vehicle": {"pose_noise": {"position_m": 0.1, "attitude_deg": 1.0}},
    }
    with recording(tmp_path) as record:
        run = execute(scenario_config("tetrapod", [quick]), watch=record)
    path = tmp_path / "recording.mcap"
    mapper = CarvingMapper(run.config.mapping)
    map_recordings([open_recording(path)], run.config.mapping, mapper=mapper)
    for name, array in run.mapper.save().items():
        np.testing.assert_array_equal(mapper.save()[name], array, err_msg=name)
    for posed in open_recording(path, Reading(pose_topic="/odometry")):
        assert posed.pose is not None
        assert posed.pose.std == pytest.approx((0.1, math.radians(1.0)))


def test_the_standard_messages_alone_make_nearly_the_same_map(scan: tuple[Run, Path]) -> None:
    """Without our own topic: ranges in single precision, turns as quaternions, mount from TF."""
    run, path = scan
    for topic in ("/odometry", "/ground_truth/odometry"):
        replay = map_recordings(
            [open_recording(path, Reading(pose_topic=topic))], run.config.mapping
        )
        np.testing.assert_array_equal(replay.mapper.voxels.coords, run.mapper.voxels.coords)
        differ = replay.mapper.voxels.log_odds != run.mapper.voxels.log_odds
        assert differ.mean() < 1e-3


def test_a_clock_offset_moves_the_pings_along_the_odometry(scan: tuple[Run, Path]) -> None:
    run, path = scan
    start, end = run.paths[0].waypoints[:2]
    first = next(iter(open_recording(path, Reading(clock_offset_s=0.05))))
    assert first.pose is not None
    assert first.pose.x_m == pytest.approx((start.x_m + end.x_m) / 2)


def test_plain_rosbags_reads_all_of_it(scan: tuple[Run, Path]) -> None:
    run, path = scan
    with AnyReader([path]) as reader:
        kinds = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        image: Any = None
        frames: Any = None
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/sonar/image" and image is None:
                image = message
            if connection.topic == "/tf_static":
                frames = message
        latched = {c.topic: c.ext.offered_qos_profiles[0].durability.name  # type: ignore[union-attr]
                   for c in reader.connections}  # fmt: skip
    assert {topic for topic, kind in latched.items() if kind == "TRANSIENT_LOCAL"} == {"/tf_static"}
    pings, scans = run.pings, len(run.paths)
    assert kinds == {
        "/sonar/image": ("marine_acoustic_msgs/msg/ProjectedSonarImage", pings),
        "/sonar/state": ("insonify_msgs/msg/PingState", pings),
        "/sonar/polar": ("sensor_msgs/msg/Image", pings),
        "/odometry": ("nav_msgs/msg/Odometry", pings),
        "/ground_truth/odometry": ("nav_msgs/msg/Odometry", pings),
        "/tf": ("tf2_msgs/msg/TFMessage", pings),
        "/tf_static": ("tf2_msgs/msg/TFMessage", 1),
        "/plan": ("nav_msgs/msg/Path", scans),
        "/map/occupied": ("sensor_msgs/msg/PointCloud2", scans),
    }
    geometry = run.config.sonar.geometry
    # the data lie range by range; the first beam is the port one, at negative y
    assert image.image.dtype == 8 and image.image.beam_count == geometry.beams
    pixels = image.image.data.view("<f4").reshape(geometry.bins, geometry.beams)
    first = next(iter(open_recording(path)))
    np.testing.assert_array_equal(pixels, first.ping.image)
    assert image.beam_directions[0].y < 0.0 < image.beam_directions[-1].y
    assert image.beam_directions[0].x == 0.0 < image.beam_directions[0].z
    np.testing.assert_allclose(image.ranges, geometry.bin_ranges_m, rtol=1e-6)
    assert image.ping_info.tx_beamwidths[0] == pytest.approx(geometry.elevation_fov_rad)
    links = {(t.header.frame_id, t.child_frame_id) for t in frames.transforms}
    assert links == {("map", "odom"), ("base_link", "sonar")}


def test_vehicle_messages_come_back(tmp_path: Path) -> None:
    head = messages.header(5, "imu")
    turn = messages.new("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    imu = messages.new(
        "sensor_msgs/Imu", header=head, orientation=turn, orientation_covariance=np.zeros(9),
        angular_velocity=messages.vector(1, 2, 3), angular_velocity_covariance=np.zeros(9),
        linear_acceleration=messages.vector(4, 5, 6), linear_acceleration_covariance=np.zeros(9),
    )  # fmt: skip
    four = np.ones(4, np.float32)
    dvl = messages.new(
        "marine_acoustic_msgs/Dvl", header=head, velocity_mode=1, dvl_type=0,
        velocity=messages.vector(0.5, 0, 0), velocity_covar=np.zeros(9), altitude=3.0,
        course_gnd=0.0, speed_gnd=0.5, num_good_beams=4, sound_speed=1500.0,
        beam_ranges_valid=True, beam_velocities_valid=False,
        beam_unit_vec=[messages.vector(0, 0, 1)] * 4, range=np.ones(4), range_covar=four,
        beam_quality=four, beam_velocity=four, beam_velocity_covar=four,
    )  # fmt: skip
    with McapWriter(tmp_path / "v.mcap") as writer:
        writer.write("/imu", imu, 5)
        writer.write("/dvl", dvl, 6)
    with AnyReader([tmp_path / "v.mcap"]) as reader:
        back: list[Any] = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    assert back[0].linear_acceleration.z == 6.0
    assert back[1].altitude == 3.0 and back[1].beam_unit_vec[3].z == 1.0


def test_a_recording_cut_anywhere_is_read_up_to_its_last_whole_chunk(
    scan: tuple[Run, Path], tmp_path: Path, rng: np.random.Generator
) -> None:
    run, path = scan
    raw = path.read_bytes()
    counts = []
    for end in sorted(rng.integers(len(raw) // 3, len(raw) - 100, 6)):
        (tmp_path / "cut.mcap").write_bytes(raw[:end])
        with pytest.warns(RecordingWarning, match="cut off"):
            counts.append(len(list(open_recording(tmp_path / "cut.mcap"))))
    assert counts == sorted(counts) and counts[0] > 0 and counts[-1] <= run.pings


_KILLED = """
import os, signal, sys
from pathlib import Path
from insonify.results.recorder import recording
from insonify.mission.loop import Mapped
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
with recording(Path(sys.argv[1])) as record:
    def watch(run, step):
        record(run, step)
        if isinstance(step, Mapped) and run.pings == 30:
            os.kill(os.getpid(), signal.SIGKILL)
    quick = {"mapping": {"voxel_m": 0.25}}
    execute(scenario_config("tetrapod", [quick]), watch=watch)
"""


def test_a_scan_killed_in_the_middle_leaves_a_recording_that_maps(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _KILLED, str(tmp_path)], env=os.environ, check=False
    )
    assert done.returncode == -signal.SIGKILL
    with pytest.warns(RecordingWarning, match="cut off"):
        replay = map_recordings(
            [open_recording(tmp_path / "recording.mcap")], MappingSettings(voxel_m=0.25)
        )
    assert 20 <= replay.result().to_json()["pings"] <= 30
    assert replay.result().to_json()["occupied_voxels"] > 0


def test_same_scan_same_bytes(scan: tuple[Run, Path], tmp_path: Path) -> None:
    run, path = scan
    with recording(tmp_path) as record:
        execute(run.config, watch=record)
    assert (tmp_path / "recording.mcap").read_bytes() == path.read_bytes()
    assert Counter(p.name for p in tmp_path.iterdir()) == Counter(
        ["recording.mcap", "foxglove.json"]
    )


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, dict[str, list[Any]]]:
    """A flown scan, and its messages as plain rosbags reads them."""
    folder = tmp_path_factory.mktemp("flight")
    layers: list[dict[str, Any]] = [
        {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 6, "baseline_scans": 1}},
        {"planner": "uniform", "vehicle": {"name": "bluerov2", "navigation": "dvl"}},
    ]
    with recording(folder) as record:
        run = execute(scenario_config("tetrapod", layers), watch=record)
    found: dict[str, list[Any]] = {}
    with AnyReader([folder / "recording.mcap"]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if hasattr(message, "header"):
                stamp = message.header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == time_ns
            found.setdefault(connection.topic, []).append((time_ns * 1e-9, message))
    return run, found


def test_a_flown_scan_tells_what_the_imu_felt(flight: tuple[Run, dict[str, list[Any]]]) -> None:
    run, found = flight
    times = np.array([time_s for time_s, _ in found["/imu"]])
    np.testing.assert_allclose(np.diff(times), 0.01, atol=1e-6)
    assert run.flight is not None
    assert times[-1] == pytest.approx(run.flight.track.moments[-1].time_s, abs=0.3)
    force = np.array([m.linear_acceleration.z for _, m in found["/imu"]])
    assert force.mean() == pytest.approx(9.81, abs=0.1)  # it hangs level and rests at both ends
    spread = run.config.vehicle.sensors.imu.accel_noise * np.sqrt(100.0)
    assert found["/imu"][0][1].linear_acceleration_covariance[0] == pytest.approx(spread**2)
    assert found["/imu"][0][1].orientation_covariance[0] == -1.0


def test_a_flown_scan_tells_how_fast_it_was(flight: tuple[Run, dict[str, list[Any]]]) -> None:
    """Doppler log and both odometries against the true positions, a ping apart."""
    _, found = flight
    truth = [(t, m) for t, m in found["/ground_truth/odometry"]]
    assert len(truth) == len(found["/odometry"]) == len(found["/sonar/image"]) > 4
    times = np.array([t for t, _ in truth])
    places = np.array([_xyz(m.pose.pose.position) for _, m in truth])
    speeds = np.linalg.norm(np.gradient(places, times, axis=0), axis=1)[1:-1]
    for topic in ("/ground_truth/odometry", "/odometry"):
        told = [np.linalg.norm(_xyz(m.twist.twist.linear)) for _, m in found[topic]][1:-1]
        np.testing.assert_allclose(told, speeds, atol=0.03)
        assert max(told) > 0.1
    logs = [(t, m) for t, m in found["/dvl"] if times[1] <= t <= times[-2]]
    for time_s, log in logs:
        assert log.num_good_beams >= 3 and log.velocity_mode == 1
        speed = np.interp(time_s, times[1:-1], speeds)
        assert np.linalg.norm(_xyz(log.velocity)) == pytest.approx(speed, abs=0.06)
        # four rays of 22.5 degrees to a bottom some metres below
        nearest = np.nanmin(log.range) * np.cos(np.radians(22.5))
        assert log.altitude == pytest.approx(nearest, rel=1e-6)
        assert 1.0 < log.altitude < 8.0
    assert len(logs) > 10


def test_a_flown_scan_tells_how_sure_it_is(flight: tuple[Run, dict[str, list[Any]]]) -> None:
    _, found = flight
    off = []
    for (_, told), (_, true) in zip(
        found["/odometry"], found["/ground_truth/odometry"], strict=True
    ):
        spread = np.array(told.pose.covariance).reshape(6, 6)
        np.testing.assert_allclose(spread, spread.T, atol=1e-12)
        assert np.linalg.eigvalsh(spread).min() > 0.0
        error = _xyz(told.pose.pose.position) - _xyz(true.pose.pose.position)
        off.append(float(error @ np.linalg.solve(spread[:3, :3], error)))
    assert 0.01 < np.mean(off) < 12.0  # 3 in the mean over many flights
    frames = {
        (link.header.frame_id, link.child_frame_id)
        for _, message in found["/tf_static"]
        for link in message.transforms
    }
    assert frames == {("map", "odom"), ("base_link", "sonar"), ("base_link", "dvl")}


def _xyz(point: Any) -> Any:
    return np.array([point.x, point.y, point.z])
