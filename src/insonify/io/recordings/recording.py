"""What a recording is: pings with their times and, where it knows them, the vehicle's poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import RecordingError
from insonify.frames import compose, enu_from_ned
from insonify.io.recordings.beams import PixelError, bits_used
from insonify.io.recordings.poses import PoseTrack, read_poses
from insonify.sonar.devices import SonarDevice
from insonify.types import Ping, Pose, PosedPing

BEAMS = ("port-to-starboard", "starboard-to-port")
"""Ways in which the columns of an image run."""
CONVENTIONS = ("enu", "ned")
"""Axes of poses: east, north, up with forward, left, up; or north, east, down with forward,
starboard, down."""
SIDE_UNKNOWN = (
    "it does not say on which side its columns begin; {} is assumed, and if that is wrong the map "
    "is a mirror image (--beams says which, `insonify check` finds out)"
)
SEAT_UNKNOWN = (
    "where the sonar sits on the vehicle is not in it; it is taken to sit in the vehicle's frame, "
    "unturned (--mount, or --sonar FILE.toml, says better)"
)
HEIGHT_UNKNOWN = (
    "how high its beams are is not in it; a nominal {:g} degrees is taken (--sonar says better)"
)


class RecordingWarning(UserWarning):
    """A recording was read in part, or something it does not say was assumed."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What the user says of a recording that it does not say itself.

    Attributes:
        device: Fills in what the format does not hold: for an image folder all of the geometry,
            for a device's own file the elevation field of view and the tilt.
        poses: A pose file, TUM or telemetry, instead of the poses in the recording.
        clock_offset_s: Added to a ping's time before its pose is looked up.
        full_scale: The value of a pixel that means 1, if it is not its type's largest.
        max_gap_s: Between poses further apart pings have none; by default as in `PoseTrack`.
        sonar_topic: Of a bag: where the pings are, if not on the only topic that has some.
        pose_topic: Of a bag: where the poses are.
        mount: The sonar on the vehicle, ``body_from_sonar``; overrules all else that tells it.
        beams: Which way the columns of an image run, a name of `BEAMS`; overrules likewise.
        convention: The axes of poses, a name of `CONVENTIONS`; by default as frames are named.
    """

    device: SonarDevice | None = None
    poses: Path | None = None
    clock_offset_s: float = 0.0
    sonar_topic: str | None = None
    pose_topic: str | None = None
    max_gap_s: float | None = None
    full_scale: float | None = None
    mount: Pose | None = None
    beams: str | None = None
    convention: str | None = None

    def __post_init__(self) -> None:
        told = (("beams", BEAMS, self.beams), ("convention", CONVENTIONS, self.convention))
        for name, known, value in told:
            if value is not None and value not in known:
                raise RecordingError(f"--{name} takes {' or '.join(known)}, not {value!r}")

    @property
    def seat(self) -> Pose:
        """Where the sonar sits on the vehicle, as far as the user says."""
        if self.mount is not None:
            return self.mount
        return Pose(0.0, 0.0, 0.0) if self.device is None else self.device.geometry.mount

    @property
    def unseated(self) -> bool:
        """Whether poses are given, and nobody says where the sonar sits on what they pose."""
        return self.poses is not None and self.mount is None and self.device is None

    def mirrors(self, port_first: bool) -> bool:
        """Whether the user says that beams run the other way than they seem to."""
        return self.beams is not None and (self.beams == BEAMS[0]) != port_first

    def columns(self, port_first: bool) -> str:
        """Which way columns that seem to run so are taken to run, in words."""
        return BEAMS[port_first == self.mirrors(port_first)].replace("-", " ")


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """An opened recording; iterate over it as often as needed, one ping in memory at a time.

    Attributes:
        path: The file or folder.
        format: What it is, for people.
        count: How many pings it holds.
        timed: Whether the pings' times are of a clock; if not they count from 0.
        facts: What the file says of itself, JSON-ready, units in the names; ``doubts`` are what
            had to be assumed of it, in sentences.
        read: Reads the pings from the start.
        exact: Whether it tells all of itself, as what is simulated does.
    """

    path: Path
    format: str
    count: int
    timed: bool
    facts: dict[str, Any]
    read: Callable[[], Iterator[PosedPing]]
    exact: bool = False

    def __iter__(self) -> Iterator[PosedPing]:
        """The pings, in the order of the recording.

        Raises:
            RecordingError: Its pixels cannot be meant as they stand, or nothing more can be read.
        """
        try:
            yield from self.read()
        except PixelError as err:
            raise RecordingError(f"{self.path}: {err}") from err


def corrected(posed: PosedPing, reading: Reading) -> PosedPing:
    """A ping that tells all of itself, as the user says that it is instead."""
    ping = posed.ping
    if reading.mirrors(port_first=True):
        ping = replace(ping, image=np.ascontiguousarray(ping.image[:, ::-1]))
    if reading.mount is not None:
        mount = reading.mount
        if ping.head_rad:  # it is the base that the user tells of, and the head turns on it
            mount = compose(mount, Pose(0.0, 0.0, 0.0, yaw_rad=ping.head_rad))
        ping = replace(ping, geometry=replace(ping.geometry, mount=mount))
    return replace(posed, ping=ping)


def refuse_scale(path: Path, reading: Reading) -> None:
    """Refuse a full scale of what was simulated.

    Raises:
        RecordingError: The user gives one.
    """
    if reading.full_scale is not None:
        raise RecordingError(f"{path}: its pixels are the simulator's, from 0 to 1; no --scale")


def refuse_beams(path: Path, reading: Reading) -> None:
    """Refuse an order of columns where there is a single beam.

    Raises:
        RecordingError: The user gives one.
    """
    if reading.beams is not None:
        raise RecordingError(
            f"{path}: a sonar of one beam has no columns for --beams to order; a head upside down "
            "is --mount with a roll of 180"
        )


def at_other_times(recording: Recording, reading: Reading) -> Recording:
    """A recording with poses of its own, looked up at the times that a clock offset tells.

    Raises:
        RecordingError: Its times go back.
    """
    if reading.clock_offset_s == 0.0 or reading.poses is not None:
        return recording
    known = [(one.ping.time_s, one.pose) for one in recording.read() if one.pose is not None]
    if not known:
        return recording
    try:
        track = PoseTrack.of(known, reading.max_gap_s)
    except ValueError as err:
        raise RecordingError(f"{recording.path}: {err}, so --clock-offset cannot be used") from err

    def read() -> Iterator[PosedPing]:
        for posed in recording.read():
            pose = track.at(posed.ping.time_s + reading.clock_offset_s)
            yield replace(posed, pose=pose)

    return replace(recording, read=read)


def in_our_axes(recording: Recording, reading: Reading) -> Recording:
    """A recording whose own poses are converted if the user says that they are of other axes."""
    if reading.convention != "ned" or reading.poses is not None:
        return recording

    def read() -> Iterator[PosedPing]:
        for posed in recording.read():
            pose = None if posed.pose is None else enu_from_ned(posed.pose)
            yield replace(posed, pose=pose)

    return replace(recording, read=read)


def scaled(
    reading: Reading, kind: np.dtype[Any], largest: Callable[[], int]
) -> tuple[Reading, list[str]]:
    """What the user says, with the full scale of pixels of a type, and how that is a guess.

    ``largest`` finds the largest pixel, and is asked only for whole numbers of more than 8 bits.
    """
    if reading.full_scale is not None or kind.kind not in "ui" or kind.itemsize == 1:
        return reading, []
    most = largest()
    bits = bits_used(kind, most)
    if bits >= kind.itemsize * 8 - 1:
        return reading, []
    full_scale = float((1 << bits) - 1)
    doubt = (
        f"its pixels are {kind.name} but go up to {most} only, so they are taken as of {bits} bits "
        f"with a full scale of {full_scale:g} (--scale says otherwise)"
    )
    return replace(reading, full_scale=full_scale), [doubt]


def span(values: Sequence[float]) -> float | list[float] | None:
    """A figure of a recording: itself if it stays, its least and greatest if it changes."""
    known = [round(value, 6) for value in values if math.isfinite(value)]
    if not known:
        return None
    low, high = min(known), max(known)
    return low if low == high else [low, high]


def with_poses(recording: Recording, reading: Reading, beside: Path | None = None) -> Recording:
    """A recording with the poses of a TUM file, given or found ``beside`` it.

    Poses are interpolated to the pings' times; a recording without a clock takes them one by one.

    Raises:
        RecordingError: The file is unreadable, or has not one pose a ping where there is no clock.
    """
    source = reading.poses or beside
    if source is None:
        return recording
    track = read_poses(source, reading.max_gap_s, ned=reading.convention == "ned")
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
