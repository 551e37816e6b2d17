"""What a recording is: pings with their times and, where it knows them, the vehicle's poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from insonify.errors import RecordingError
from insonify.io.recordings.beams import PixelError
from insonify.io.recordings.poses import PoseTrack, read_poses
from insonify.sonar.devices import SonarDevice
from insonify.types import Ping, Pose, PosedPing

MOST_PIXELS = 64_000_000
"""A sonar image larger than this is damage, not data."""


class RecordingWarning(UserWarning):
    """A recording was read in part, or something it does not say was assumed."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What the user says of a recording that it does not say itself.

    Attributes:
        device: Fills in what the format does not hold: for an image folder all of the geometry,
            for a device's own file the elevation field of view and the tilt.
        poses: A pose file in TUM format, instead of the poses in the recording.
        clock_offset_s: Added to a ping's time before its pose is looked up.
        full_scale: The value of a pixel that means 1, if it is not its type's largest.
        max_gap_s: Between poses further apart pings have none; by default as in `PoseTrack`.
        sonar_topic: Of a bag: where the pings are, if not on the only topic that has some.
        pose_topic: Of a bag: where the poses are.
    """

    device: SonarDevice | None = None
    poses: Path | None = None
    clock_offset_s: float = 0.0
    sonar_topic: str | None = None
    pose_topic: str | None = None
    max_gap_s: float | None = None
    full_scale: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """An opened recording; iterate over it as often as needed, one ping in memory at a time.

    Attributes:
        path: The file or folder.
        format: What it is, for people.
        count: How many pings it holds.
        timed: Whether the pings' times are of a clock; if not they count from 0.
        facts: What the file says of itself, JSON-ready, units in the names.
        read: Reads the pings from the start.
    """

    path: Path
    format: str
    count: int
    timed: bool
    facts: dict[str, Any]
    read: Callable[[], Iterator[PosedPing]]

    def __iter__(self) -> Iterator[PosedPing]:
        """The pings, in the order of the recording.

        Raises:
            RecordingError: Its pixels cannot be meant as they stand, or nothing more can be read.
        """
        try:
            yield from self.read()
        except PixelError as err:
            raise RecordingError(f"{self.path}: {err}") from err


def with_poses(recording: Recording, reading: Reading, beside: Path | None = None) -> Recording:
    """A recording with the poses of a TUM file, given or found ``beside`` it.

    Poses are interpolated to the pings' times; a recording without a clock takes them one by one.

    Raises:
        RecordingError: The file is unreadable, or has not one pose a ping where there is no clock.
    """
    source = reading.poses or beside
    if source is None:
        return recording
    track = read_poses(source, reading.max_gap_s)
    timed = recording.timed
    if not timed and len(track) != recording.count:
        raise RecordingError(
            f"{source}: {recording.path.name} has no clock and {recording.count} pings, so this "
            f"file needs as many poses, one for each ping in order, not {len(track)}"
        )
    facts = recording.facts | {"poses": f"{len(track)} in {source.name}"}
    if timed:
        facts["max_gap_s"] = track.max_gap_s

    def read() -> Iterator[PosedPing]:
        for number, recorded in enumerate(recording.read()):
            pose = _pose_of(track, recorded.ping, number, timed, reading.clock_offset_s)
            yield PosedPing(recorded.ping, pose)

    return Recording(recording.path, recording.format, recording.count, timed, facts, read)


def _pose_of(
    track: PoseTrack, ping: Ping, number: int, timed: bool, offset_s: float
) -> Pose | None:
    return track.at(ping.time_s + offset_s) if timed else track.sample(number)
