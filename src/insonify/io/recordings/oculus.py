"""Blueprint Oculus raw pings (``.raw``): network messages back to back, simple ping results.

Layout after the vendor's message structures as used by APL's liboculus and ENSTA's driver.
Column 0 is the port side; row ``i`` lies around ``(i + 0.5) * range resolution``; the bearings
come from the table in each message.  Messages of other kinds are skipped by their length.  The
file holds no time of day and no pose; a log (`oculus_log`) holds the same messages, with times.
"""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from insonify.errors import RecordingError
from insonify.io.recordings.beams import EvenFan, even_fan
from insonify.io.recordings.oculus_log import START as LOG_START
from insonify.io.recordings.oculus_log import Item, next_start, sonar_items
from insonify.io.recordings.recording import (
    HEIGHT_UNKNOWN,
    SEAT_UNKNOWN,
    Reading,
    Recording,
    RecordingWarning,
    scaled,
    span,
)
from insonify.limits import MOST_MESSAGE_BYTES
from insonify.types import Array, Float64, Ping, PosedPing

START = b"SO"
_SIMPLE_PING = 0x23
_HEADER = struct.Struct("<HHHHHIH")
ELEVATION_DEG = {True: 12.0, False: 20.0}
"""Nominal height of the beams (liboculus, M1200d), above 1.5 MHz and below."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the fields of a simple ping result lie, from the start of the message."""

    ping_id: int
    frequency: int
    sound_speed: int
    start_time: tuple[str, int]
    sizes: tuple[str, int]
    image: tuple[str, int]
    bearings: int


_V1 = _Layout(53, 61, 85, ("<I", 93), ("<BdHH", 97), ("<II", 110), 122)
_V2 = _Layout(89, 97, 145, ("<d", 153), ("<BdHH", 161), ("<II", 190), 202)


@dataclass(frozen=True, slots=True, eq=False)
class _Message:
    """One ping, as far as it is told without its pixels."""

    at: int
    version: int
    ping_id: int
    frequency_hz: float
    sound_speed_mps: float
    clock: float
    sample_bytes: int
    range_resolution_m: float
    ranges: int
    beams: int
    image_at: int
    row_bytes: int
    gain_bytes: int
    bearings_rad: Float64
    item: Item | None = None

    @property
    def shape(self) -> tuple[Any, ...]:
        """What must be equal for two pings to have one geometry."""
        return (self.range_resolution_m, self.ranges, self.beams, self.bearings_rad.tobytes())


def read_oculus(path: Path, reading: Reading) -> Recording:
    """Open a file of Oculus messages.

    Raises:
        RecordingError: There is no whole simple ping result in it.
    """
    with path.open("rb") as file:
        logged = file.read(4) == LOG_START
    messages = list(_scan_log(path) if logged else _scan(path))
    if not messages:
        raise RecordingError(f"{path}: no whole Oculus simple ping result in it")
    first = messages[0]
    reading, doubts = scaled(
        reading, np.dtype(f"u{first.sample_bytes}"), lambda: _largest(path, messages)
    )

    def read() -> Iterator[PosedPing]:
        fan, shape = _fan(path, first, reading), first.shape
        with path.open("rb") as file:
            for message in messages:
                if message.shape != shape:
                    fan, shape = _fan(path, message, reading), message.shape
                image = fan.image(_pixels(message, file), reading.full_scale)
                time_s = 0.0 if message.item is None else message.item.time_s
                yield PosedPing(Ping(image, fan.geometry, time_s))

    fan = _fan(path, first, reading)
    if reading.device is None:
        doubts.append(HEIGHT_UNKNOWN.format(math.degrees(fan.geometry.elevation_fov_rad)))
    if reading.unseated:
        doubts.append(SEAT_UNKNOWN)
    facts = _facts(messages, fan) | {
        "columns": reading.columns(port_first=True),
        "doubts": doubts,
    }
    name = "Oculus log" if logged else "Oculus simple ping results"
    return Recording(path, name, len(messages), logged, facts, read)


def _scan_log(path: Path) -> Iterator[_Message]:
    """The whole simple ping results of a log; a warning says what was left out."""
    lost: list[int] = []
    skipped = 0
    with path.open("rb") as file:
        for item in sonar_items(path, lost):
            raw = item.read(file, 1 << 16)
            if len(raw) < _HEADER.size or not math.isfinite(item.time_s):
                skipped += 1
                continue
            oculus_id, _, _, kind, version, payload, _ = _HEADER.unpack(raw[: _HEADER.size])
            if oculus_id == 0x4F53 and kind != _SIMPLE_PING:
                continue
            length = _HEADER.size + payload
            whole = length <= (MOST_MESSAGE_BYTES if item.packed else item.size)
            start = 0 if item.packed else item.at
            message = _message(raw, start, length, version) if whole else None
            if oculus_id != 0x4F53 or message is None:
                skipped += 1
            else:
                yield replace(message, item=item)
    _warn_of_damage(path, skipped, len(lost))


def _scan(path: Path) -> Iterator[_Message]:
    """The whole simple ping results of a file; a warning says what was left out."""
    size = path.stat().st_size
    lost = skipped = 0
    with path.open("rb") as file:
        at = 0
        while at + _HEADER.size <= size:
            file.seek(at)
            oculus_id, _, _, kind, version, payload, _ = _HEADER.unpack(file.read(_HEADER.size))
            length = _HEADER.size + payload
            if oculus_id != 0x4F53 or length > MOST_MESSAGE_BYTES:
                lost += 1
                at = next_start(file, at + 1, size, START)
                continue
            if at + length > size:
                skipped += 1
                break
            if kind == _SIMPLE_PING:
                file.seek(at)
                message = _message(file.read(min(length, 1 << 16)), at, length, version)
                if message is None:
                    skipped += 1
                else:
                    yield message
            at += length
    _warn_of_damage(path, skipped, lost)


def _warn_of_damage(path: Path, skipped: int, lost: int) -> None:
    if lost or skipped:
        warnings.warn(
            f"{path}: damaged or cut off; {skipped} pings left out, bytes skipped at {lost} places",
            RecordingWarning,
            stacklevel=3,
        )


def _message(raw: bytes, at: int, length: int, version: int) -> _Message | None:
    """A simple ping result; None if what it says of itself does not fit into it."""
    layout = _V2 if version == 2 else _V1
    if len(raw) < layout.bearings:
        return None
    sample, resolution, ranges, beams = struct.unpack_from(*_at(layout.sizes, raw))
    image_at, image_bytes = struct.unpack_from(*_at(layout.image, raw))
    row = beams * (sample + 1)
    sane = (
        sample in (0, 1, 3)
        and ranges > 1
        and beams > 1
        and math.isfinite(resolution)
        and 1e-5 < resolution < 10.0
        and layout.bearings + 2 * beams <= min(image_at, len(raw))
        and image_at + image_bytes <= length
    )
    # some firmware begins each row with a gain of four bytes; the image's size tells
    gain = 4 if sane and image_bytes == ranges * (row + 4) else 0
    if not sane or image_bytes != ranges * (row + gain):
        return None
    bearings = np.frombuffer(raw, "<i2", beams, layout.bearings) * 0.01
    if (np.diff(bearings) <= 0).any() or abs(bearings).max() > 90.0:
        return None
    (clock,) = struct.unpack_from(*_at(layout.start_time, raw))
    return _Message(
        at=at,
        version=2 if version == 2 else 1,
        ping_id=struct.unpack_from("<I", raw, layout.ping_id)[0],
        frequency_hz=struct.unpack_from("<d", raw, layout.frequency)[0],
        sound_speed_mps=struct.unpack_from("<d", raw, layout.sound_speed)[0],
        clock=float(clock),
        sample_bytes=sample + 1,
        range_resolution_m=resolution,
        ranges=ranges,
        beams=beams,
        image_at=at + image_at,
        row_bytes=row + gain,
        gain_bytes=gain,
        bearings_rad=np.radians(bearings.astype(np.float64)),
    )


def _at(field: tuple[str, int], raw: bytes) -> tuple[str, bytes, int]:
    return field[0], raw, field[1]


def _largest(path: Path, messages: list[_Message]) -> int:
    with path.open("rb") as file:
        return max(int(_pixels(message, file).max()) for message in messages)


def _pixels(message: _Message, file: BinaryIO) -> Array:
    size = message.ranges * message.row_bytes
    if message.item is not None and message.item.packed:
        raw = message.item.read(file)[message.image_at :][:size]
    else:
        file.seek(message.image_at)
        raw = file.read(size)
    if len(raw) < size:
        raise ValueError(f"ping {message.ping_id} is cut off")
    rows = np.frombuffer(raw, np.uint8).reshape(message.ranges, message.row_bytes)
    pixels = np.ascontiguousarray(rows[:, message.gain_bytes :])
    return pixels.view(f"<u{message.sample_bytes}")


def _fan(path: Path, message: _Message, reading: Reading) -> EvenFan:
    device = reading.device
    elevation = device.elevation_fov_deg if device else ELEVATION_DEG[message.frequency_hz > 1.5e6]
    ranges = (np.arange(message.ranges, dtype=np.float64) + 0.5) * message.range_resolution_m
    try:
        fan = even_fan(
            -message.bearings_rad,
            ranges,
            math.radians(elevation),
            reading.seat,
            mirrored=reading.mirrors(port_first=True),
        )
    except ValueError as err:
        raise RecordingError(f"{path}: damaged, {err}") from err
    return fan


def _facts(messages: list[_Message], fan: EvenFan) -> dict[str, Any]:
    first = messages[0]
    speeds = [message.sound_speed_mps for message in messages]
    bearings = np.degrees(first.bearings_rad)
    return {
        "device": "Blueprint Oculus",
        "message_version": first.version,
        "ping_ids": [first.ping_id, messages[-1].ping_id],
        "frequency_hz": _finite(first.frequency_hz),
        "sound_speed_mps": span(speeds),
        "range_resolution_m": first.range_resolution_m,
        "bits": 8 * first.sample_bytes,
        "gain_in_rows": first.gain_bytes > 0,
        "sonar_clock": _finite(first.clock),
        "bearing_first_deg": round(float(bearings[0]), 3),
        "bearing_last_deg": round(float(bearings[-1]), 3),
        "beams_evened": fan.beams is not None,
        "poses": "none",
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
