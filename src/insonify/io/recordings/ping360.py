"""Logs of Blue Robotics' Ping Viewer (``.bin``) of a Ping360, a mechanically scanning sonar.

The log is a Qt data stream, big-endian: a header of strings, then records of a time and of what
one read from the link gave, which need not be whole messages.  Messages are those of the Ping
protocol (2300 ``device_data``, 2301 ``auto_device_data``), little-endian, with a checksum.  Times
are elapsed since the log began.

Angles are gradians; as Ping Viewer draws a head that points up, 200 is ahead and they rise to
starboard.
"""

from __future__ import annotations

import math
import struct
import warnings
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError
from insonify.frames import compose, wrapped
from insonify.io.recordings.beams import unit_pixels
from insonify.io.recordings.recording import (
    SEAT_UNKNOWN,
    Reading,
    Recording,
    RecordingWarning,
    refuse_beams,
)
from insonify.types import FanGeometry, Ping, Pose, PosedPing

TITLE = "PingViewer sensor log file"
START = struct.pack(">I", 2 * len(TITLE)) + TITLE.encode("utf-16-be")
PLAIN_START = struct.pack(">I", len(TITLE)) + TITLE.encode()
"""As other writers have it, in UTF-8."""
BEAM_DEG = (2.0, 25.0)
"""Width and height of the beam (Blue Robotics)."""
SOUND_SPEED_MPS = 1500.0
"""Ping Viewer's own, which the log does not hold."""
MOST_BYTES = 1 << 30
_TICK_S = 25e-9
_AHEAD_GRAD, _TURN_GRAD = 200, 400
_PINGS = {2300: struct.Struct("<BBHHHHHH"), 2301: struct.Struct("<BBHHHHHHBBHH")}
_NULL = 0xFFFFFFFF


@dataclass(frozen=True, slots=True, eq=False)
class _Profile:
    """One ping."""

    time_s: float
    angle_grad: int
    sample_s: float
    frequency_khz: int
    echoes: bytes


def read_ping360(path: Path, reading: Reading) -> Recording:
    """Open a log of a Ping360.

    Raises:
        RecordingError: It is of another device, too large, or holds no ping.
    """
    if path.stat().st_size > MOST_BYTES:
        raise RecordingError(f"{path}: larger than 1 GiB; split it")
    refuse_beams(path, reading)
    profiles = list(_profiles(path, path.read_bytes()))
    if not profiles:
        raise RecordingError(f"{path}: no pings of a Ping360 in it")
    width_deg, height_deg = BEAM_DEG
    if reading.device is not None:
        width_deg = reading.device.azimuth_fov_deg
        height_deg = reading.device.elevation_fov_deg

    def read() -> Iterator[PosedPing]:
        for one in profiles:
            bins = len(one.echoes)
            yaw = wrapped(-(one.angle_grad - _AHEAD_GRAD) * math.tau / _TURN_GRAD)
            fan = FanGeometry(
                azimuth_fov_rad=math.radians(width_deg),
                elevation_fov_rad=math.radians(height_deg),
                beams=1,
                bins=bins,
                range_min_m=0.0,
                range_max_m=bins * one.sample_s * SOUND_SPEED_MPS / 2.0,
                mount=compose(reading.seat, Pose(0.0, 0.0, 0.0, yaw_rad=yaw)),
            )
            pixels = np.frombuffer(one.echoes, np.uint8).reshape(-1, 1)
            yield PosedPing(Ping(unit_pixels(pixels, reading.full_scale), fan, one.time_s, yaw))

    facts = {
        "device": "Ping360",
        "frequency_hz": [1e3 * k for k in sorted({one.frequency_khz for one in profiles})[:2]],
        "sound_speed_mps": SOUND_SPEED_MPS,
        "poses": "none",
        "doubts": [
            "its head is taken to point up, with 200 gradians ahead; one that points down is "
            '--mount "0 0 0 180 0 0"',
            f"the sound speed is not in it; {SOUND_SPEED_MPS:g} m/s is taken",
            "its times are counted from the log's begin; --clock-offset moves them to those of "
            "the poses",
            *([SEAT_UNKNOWN] if reading.unseated else []),
        ],
    }
    return Recording(path, "Ping360 log of Ping Viewer", len(profiles), True, facts, read)


def _profiles(path: Path, content: bytes) -> Iterator[_Profile]:
    """The pings of a log; a warning says how much of it is damaged."""
    stream, ends, times, cut = _stream(path, content)
    at = lost = 0
    while (at := stream.find(b"BR", at)) >= 0 and at + 10 <= len(stream):
        size, kind = struct.unpack_from("<HH", stream, at + 2)
        end = at + 10 + size
        whole = end <= len(stream)
        if not whole or sum(stream[at : end - 2]) & 0xFFFF != _checksum(stream, end):
            lost += 1
            at += 1
            continue
        profile = _profile(stream[at + 8 : end - 2], kind, times[bisect_left(ends, end)])
        if profile is not None:
            yield profile
        at = end
    if lost or cut:
        warnings.warn(
            f"{path}: damaged or cut off; bytes are skipped at {lost + cut} places",
            RecordingWarning,
            stacklevel=4,
        )


def _checksum(stream: bytes, end: int) -> int:
    return int(struct.unpack_from("<H", stream, end - 2)[0])


def _profile(payload: bytes, kind: int, time_s: float) -> _Profile | None:
    """A message as a ping, None if it is another, or its head moved without one."""
    layout = _PINGS.get(kind)
    if layout is None or len(payload) < layout.size:
        return None
    fields = layout.unpack_from(payload)
    angle, period, frequency, length = fields[2], fields[4], fields[5], fields[-1]
    echoes = payload[layout.size :]
    if len(echoes) != length or length < 2 or not (angle < _TURN_GRAD and period > 0):
        return None
    return _Profile(time_s, angle, period * _TICK_S, frequency, echoes)


class _Cursor:
    """Reads Qt's arrays and strings one after another."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    @property
    def done(self) -> bool:
        return self._at >= len(self._content)

    def numbers(self, layout: str) -> tuple[int, ...]:
        found = struct.unpack_from(layout, self._content, self._at)
        self._at += struct.calcsize(layout)
        return found

    def array(self) -> bytes:
        (size,) = self.numbers(">I")
        if size == _NULL:
            return b""
        if self._at + size > len(self._content):
            raise ValueError("cut off")
        self._at += size
        return self._content[self._at - size : self._at]

    def text(self) -> str:
        raw = self.array()
        return raw.decode("utf-16-be" if raw[:1] == b"\0" else "utf-8")


def _stream(path: Path, content: bytes) -> tuple[bytes, list[int], list[float], int]:
    """All that came over the link, where each record ends in it and when, and whether it is cut."""
    cursor = _Cursor(content)
    try:
        cursor.text()
        cursor.numbers(">i")
        for _ in range(5):
            cursor.text()
        _, device = cursor.numbers(">ii")
    except (struct.error, ValueError) as err:
        raise RecordingError(f"{path}: damaged or cut off in its header ({err})") from err
    if device == 1:
        raise RecordingError(
            f"{path}: a log of a Ping1D, an echo sounder; only a Ping360's is read"
        )
    chunks: list[bytes] = []
    ends: list[int] = []
    times: list[float] = []
    length, before_s, day_s = 0, 0.0, 0.0
    while not cursor.done:
        try:
            hours, minutes, seconds = cursor.text().split(":")
            time_s = day_s + 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds)
            chunk = cursor.array()
        except (struct.error, ValueError):
            return b"".join(chunks), ends, times, 1
        if time_s < before_s - 43200.0:  # past midnight
            day_s += 86400.0
            time_s += 86400.0
        before_s = time_s
        chunks.append(chunk)
        length += len(chunk)
        ends.append(length)
        times.append(time_s)
    return b"".join(chunks), ends, times, 0
