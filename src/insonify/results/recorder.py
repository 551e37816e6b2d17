"""A simulated scan as a recording: a consumer of the mission's steps, like progress or a report.

Frames (REP 105): map, odom, base_link, sonar; map and odom coincide.  A mission without a clock
of its own pings ten times a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from insonify.frames import transform_from_pose
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.mcap_writing import McapWriter
from insonify.mapping.voxels import probability_from_log_odds
from insonify.mission.loop import Decided, Pinged, Scanned, Step
from insonify.mission.run import Flight, Run
from insonify.results.files import RECORDING
from insonify.results.replay import ping_messages
from insonify.types import Pose, PosedPing
from insonify.vehicle.craft import Craft, DvlReading, ImuReading
from insonify.vehicle.instruments import SensorSettings

SONAR, STATES = "sonar", "/sonar/state"
ESTIMATE, TRUTH = "/odometry", "/ground_truth/odometry"
PLANS, OCCUPIED = "/plan", "/map/occupied"
IMU, DVL = "/imu", "/dvl"
SOUND_SPEED_MPS = 1500.0
"""Told in each ping; the simulator's ranges are exact at any speed."""
_STEP_NS = 100_000_000


@contextmanager
def recording(folder: Path) -> Iterator[Callable[[Run, Step], None]]:
    """A consumer of a run's steps that writes ``recording.mcap`` and its Foxglove layout."""
    layout = resources.files("insonify.results").joinpath("foxglove.json")
    (folder / "foxglove.json").write_text(layout.read_text(encoding="utf-8"), encoding="utf-8")
    with McapWriter(folder / RECORDING) as writer:
        yield ScanRecorder(writer).watch


class Writer(Protocol):
    """Where a recorder's messages go."""

    def write(self, topic: str, message: Any, time_ns: int) -> None:
        """Take a message."""


class ScanRecorder:
    """Writes the steps of one run."""

    def __init__(self, writer: Writer) -> None:
        """Record into an open file, or onto the bus."""
        self._writer = writer
        self._now_ns = 0
        self._mount: Pose | None = None

    @property
    def stamp_ns(self) -> int:
        """Of the last ping."""
        return self._now_ns

    def watch(self, run: Run, step: Step) -> None:
        """Record a step."""
        if run.flight is not None:
            self._record_readings(run.flight)
        if isinstance(step, Decided) and step.decision.path is not None:
            waypoints = step.decision.path.waypoints
            self._write(PLANS, messages.path(waypoints, self._now_ns, "map"))
        elif isinstance(step, Pinged):
            self._record_ping(run, step.posed)
        elif isinstance(step, Scanned):
            self._record_map(run)

    def _record_ping(self, run: Run, posed: PosedPing) -> None:
        ping, pose = posed.ping, posed.pose
        truth = posed.true_pose
        assert pose is not None
        assert truth is not None
        time_ns = round(ping.time_s * 1e9)
        self._now_ns = time_ns if time_ns > self._now_ns else self._now_ns + _STEP_NS
        now = self._now_ns
        mount = ping.geometry.mount
        if mount != self._mount:
            self._mount = mount
            sonar = transform_from_pose(mount) @ messages.IMAGE_FROM_SONAR
            links = [("map", "odom", np.eye(4)), ("base_link", "sonar", sonar)]
            if run.flight is not None:
                log = run.flight.voyage.settings.sensors.dvl
                links.append(("base_link", "dvl", transform_from_pose(Pose(*log.position_m))))
            self._write("/tf_static", messages.transforms(links, now))
        link = ("odom", "base_link", transform_from_pose(pose))
        self._write("/tf", messages.transforms([link], now))
        craft = None if run.flight is None else run.flight.voyage.craft
        if craft is None:
            self._write(ESTIMATE, messages.odometry(pose, now, "odom"))
            self._write(TRUTH, messages.odometry(truth, now, "map"))
        else:
            self._write(ESTIMATE, believed_odometry(craft, pose, now))
            moving = craft.true_state[7:13]
            self._write(TRUTH, messages.odometry(truth, now, "map", moving))
        frequency_hz = 1e3 * run.config.sonar.frequency_khz
        words = messages.words_from_generator(run.noise)
        told = ping_messages(SONAR, posed, words, now, frequency_hz, SOUND_SPEED_MPS)
        told[f"/{SONAR}/polar"] = messages.polar_picture(ping, now, SONAR)
        for topic, message in told.items():
            self._write(topic, message)

    def _record_readings(self, flight: Flight) -> None:
        """Record what the sensors have measured since the last step, at its own times."""
        sensors = flight.voyage.settings.sensors
        for topic, message, now in reading_messages(flight.track.readings, sensors):
            self._writer.write(topic, message, now)

    def _record_map(self, run: Run) -> None:
        voxels = run.mapper.voxels
        occupied = voxels.select()
        probability = probability_from_log_odds(occupied.log_odds)
        points = np.column_stack([voxels.centres_m(occupied), probability])
        names = ("x", "y", "z", "probability")
        self._write(OCCUPIED, messages.point_cloud(points, names, self._now_ns, "map"))

    def _write(self, topic: str, message: object) -> None:
        self._writer.write(topic, message, self._now_ns)


def reading_messages(
    readings: Iterable[ImuReading | DvlReading], sensors: SensorSettings
) -> Iterator[tuple[str, Any, int]]:
    """Topic, message and stamp of what sensors have measured."""
    for reading in readings:
        if isinstance(reading, ImuReading):
            for time_s, values in zip(reading.times_s.tolist(), reading.values, strict=True):
                now = round(time_s * 1e9)
                yield IMU, messages.imu(values, now, "base_link", sensors.imu), now
        else:
            now = round(reading.time_s * 1e9)
            yield DVL, messages.dvl(reading, now, "dvl", sensors.dvl, SOUND_SPEED_MPS), now


def believed_odometry(craft: Craft, pose: Pose, time_ns: int) -> object:
    """The odometry of what a vehicle believes of itself."""
    motion = craft.motion()
    turn = motion.turn
    velocity = np.concatenate([turn.T @ motion.velocity_m_s, motion.rate_rad_s])
    covariance = craft.covariance
    if covariance is not None:  # its angles are the body's, the message's the world's
        turned = np.kron(np.diag([0.0, 1.0]), turn) + np.kron(np.diag([1.0, 0.0]), np.eye(3))
        covariance = turned @ covariance @ turned.T
    return messages.odometry(pose, time_ns, "odom", velocity, covariance)
