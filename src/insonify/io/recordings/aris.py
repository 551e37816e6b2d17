"""ARIS recordings, version 5 (``.aris``): a file header, then frames of header and samples.

Layout after Sound Metrics' ARIS file SDK (type definitions and "Understanding ARIS data").  The
number of frames follows from the file's size, since the writer's count may be wrong.  Ranges
follow from the delays and the sound speed of each frame; the header's window start and length are
those delays at a nominal 1450 m/s and are only reported.  Beam 0 is the rightmost.
"""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from insonify.errors import RecordingError
from insonify.io.recordings.beams import EvenFan, even_fan
from insonify.io.recordings.recording import (
    HEIGHT_UNKNOWN,
    SEAT_UNKNOWN,
    Reading,
    Recording,
    RecordingWarning,
)
from insonify.types import Float64, Ping, PosedPing

MAGIC = b"DDF\x05"
_HEADER_BYTES = 1024
_BEAMS_OF_PING_MODE = {
    **dict.fromkeys((1, 2), 48),
    **dict.fromkeys((3, 4, 5), 96),
    **dict.fromkeys((6, 7, 8), 64),
    **dict.fromkeys((9, 10, 11, 12), 128),
}
_SYSTEMS = {0: "ARIS 1800", 1: "ARIS 3000", 2: "ARIS 1200"}
_FIELDS = {
    "time_us": ("<Q", 4),
    "version": ("<4s", 12),
    "window_start_m": ("<f", 52),
    "window_length_m": ("<f", 56),
    "compass_heading_deg": ("<f", 160),
    "water_temperature_deg_c": ("<f", 224),
    "tilt_deg": ("<f", 248),
    "ping_mode": ("<I", 436),
    "frequency_high": ("<I", 440),
    "sample_period_us": ("<I", 452),
    "frame_rate_hz": ("<f", 460),
    "sound_speed_mps": ("<f", 464),
    "samples": ("<I", 468),
    "start_delay_us": ("<I", 476),
    "large_lens": ("<I", 480),
    "system": ("<I", 484),
    "serial_number": ("<I", 488),
    "reordered": ("<I", 516),
}
# odd polynomials a u + b u^3 + c u^5 in degrees, u from -1 to 1 over the beams, fitted to the
# SDK's beam tables to 0.064 degrees or better; (system is a 3000, beams, telephoto lens)
_BEAM_ANGLES_DEG = {
    (False, 48, False): (16.0901, -3.3308, 0.8195),
    (False, 48, True): (7.1003, -0.5233, 0.1701),
    (False, 96, False): (16.3213, -3.2556, 0.7493),
    (False, 96, True): (7.5913, -0.1271, -0.0460),
    (True, 128, False): (15.0915, -0.4992, 0.1384),
    (True, 64, False): (15.0750, -0.4647, 0.1163),
}
_LOPSIDED_DEG = {(False, 96, False): (0.0016, 0.0683)}
ELEVATION_DEG = 14.0
"""Height of the beams with the standard lens, which the file does not hold."""


def read_aris(path: Path, reading: Reading) -> Recording:
    """Open an ARIS recording.

    Raises:
        RecordingError: It is no ARIS file of version 5, or is damaged before its second frame.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
        if len(head) < _HEADER_BYTES or head[:4] != MAGIC:
            raise RecordingError(
                f"{path}: not an ARIS recording of version 5 (it begins with {head[:4]!r}, not "
                f"{MAGIC!r})"
            )
        first = _frame_header(path, file.read(_HEADER_BYTES), 0)
    beams, samples = _BEAMS_OF_PING_MODE[first["ping_mode"]], first["samples"]
    frame_bytes = _HEADER_BYTES + beams * samples
    count, rest = divmod(size - _HEADER_BYTES, frame_bytes)
    if count < 1:
        raise RecordingError(
            f"{path}: cut off in its first frame, of {beams} beams x {samples} samples; record "
            "or copy it again"
        )
    if rest:
        _warn(path, f"cut off in frame {count + 1}; the {count} whole ones are read")
    fan = _fan(path, first, reading)

    def read() -> Iterator[PosedPing]:
        with path.open("rb") as file:
            for number in range(count):
                file.seek(_HEADER_BYTES + number * frame_bytes)
                ping = _ping(path, file, number, first, fan, reading)
                if ping is None:
                    return
                yield PosedPing(ping)

    return Recording(path, "ARIS version 5", count, True, _facts(first, beams, fan, reading), read)


def beam_azimuths_rad(system: int, beams: int, telephoto: bool) -> Float64:
    """Azimuth of each beam, (beams,), in the file's order: starboard to port.

    Raises:
        KeyError: The SDK has no table for this lens and number of beams.
    """
    kind = (system == 1, beams, telephoto)
    a, b, c = _BEAM_ANGLES_DEG[kind]
    constant, square = _LOPSIDED_DEG.get(kind, (0.0, 0.0))
    u = (2.0 * np.arange(beams) - (beams - 1)) / (beams - 1)
    return np.radians(a * u + b * u**3 + c * u**5 + constant + square * u**2)


def _frame_header(path: Path, raw: bytes, number: int) -> dict[str, Any]:
    if len(raw) < _HEADER_BYTES:
        raise RecordingError(f"{path}: no frames in it; record or copy it again")
    frame = {name: struct.unpack_from(kind, raw, at)[0] for name, (kind, at) in _FIELDS.items()}
    problem = ""
    if frame["version"] != MAGIC:
        problem = f"begins with {frame['version']!r}, not {MAGIC!r}"
    elif frame["ping_mode"] not in _BEAMS_OF_PING_MODE:
        problem = f"has the unknown ping mode {frame['ping_mode']}"
    elif not 0 < frame["samples"] <= 65536:
        problem = f"has {frame['samples']} samples a beam"
    elif not 1000.0 < frame["sound_speed_mps"] < 2000.0:
        problem = f"has a sound speed of {frame['sound_speed_mps']:g} m/s"
    elif not (0 < frame["sample_period_us"] < 10_000 and frame["start_delay_us"] < 1_000_000):
        problem = "has a sample period or start delay that no ARIS has"
    elif frame["reordered"] != 1:
        problem = "holds samples not yet put in the order of the beams"
    if problem:
        raise RecordingError(f"{path}: damaged, frame {number + 1} {problem}")
    return frame


def _ping(
    path: Path,
    file: BinaryIO,
    number: int,
    first: dict[str, Any],
    fan: EvenFan,
    reading: Reading,
) -> Ping | None:
    """A frame as a ping; None, with a warning, if it is damaged and an earlier one was not."""
    beams = _BEAMS_OF_PING_MODE[first["ping_mode"]]
    try:
        frame = _frame_header(path, file.read(_HEADER_BYTES), number)
        for name in ("ping_mode", "samples"):
            if frame[name] != first[name]:
                raise RecordingError(
                    f"{path}: damaged, the {name} of frame {number + 1} is {frame[name]}, not "
                    f"{first[name]} as before"
                )
        samples = file.read(beams * first["samples"])
        if len(samples) < beams * first["samples"]:
            raise RecordingError(f"{path}: cut off in frame {number + 1}")
        if _timing(frame) != _timing(first):
            fan = _fan(path, frame, reading)
    except RecordingError as err:
        if number == 0:
            raise
        _warn(None, f"{err}; the {number} frames before it are read")
        return None
    pixels = np.frombuffer(samples, np.uint8).reshape(first["samples"], beams)
    return Ping(
        fan.image(pixels[:, ::-1], reading.full_scale), fan.geometry, frame["time_us"] * 1e-6
    )


def _timing(frame: dict[str, Any]) -> tuple[Any, ...]:
    names = ("sound_speed_mps", "sample_period_us", "start_delay_us", "large_lens", "system")
    return tuple(frame[name] for name in names)


def _fan(path: Path, frame: dict[str, Any], reading: Reading) -> EvenFan:
    beams = _BEAMS_OF_PING_MODE[frame["ping_mode"]]
    lens = "telephoto" if frame["large_lens"] else "standard"
    try:
        azimuths = beam_azimuths_rad(frame["system"], beams, bool(frame["large_lens"]))
    except KeyError as err:
        system = _SYSTEMS.get(frame["system"], f"system {frame['system']}")
        raise RecordingError(
            f"{path}: no beam directions are known of an {system} with {beams} beams and the "
            f"{lens} lens"
        ) from err
    metres_per_us = 0.5e-6 * frame["sound_speed_mps"]
    start_m = frame["start_delay_us"] * metres_per_us
    step_m = frame["sample_period_us"] * metres_per_us
    ranges = start_m + (np.arange(frame["samples"]) + 0.5) * step_m
    device = reading.device
    elevation = device.elevation_fov_deg if device else ELEVATION_DEG
    mirrored = reading.mirrors(port_first=False)
    return even_fan(
        azimuths[::-1], ranges, math.radians(elevation), reading.seat, mirrored=mirrored
    )


def _facts(frame: dict[str, Any], beams: int, fan: EvenFan, reading: Reading) -> dict[str, Any]:
    lens = "telephoto" if frame["large_lens"] else "standard"
    azimuths = np.degrees(beam_azimuths_rad(frame["system"], beams, bool(frame["large_lens"])))
    return {
        "device": _SYSTEMS.get(frame["system"], f"system {frame['system']}"),
        "lens": lens,
        "serial_number": frame["serial_number"],
        "started": datetime.fromtimestamp(frame["time_us"] * 1e-6, UTC).isoformat()
        if frame["time_us"] < 4_102_444_800_000_000
        else None,
        "frame_rate_hz": _finite(frame["frame_rate_hz"]),
        "sound_speed_mps": _finite(frame["sound_speed_mps"]),
        "window_start_m": _finite(frame["window_start_m"]),
        "window_length_m": _finite(frame["window_length_m"]),
        "tilt_deg": _finite(frame["tilt_deg"]),
        "compass_heading_deg": _finite(frame["compass_heading_deg"]),
        "water_temperature_deg_c": _finite(frame["water_temperature_deg_c"]),
        "bearing_first_deg": round(float(-azimuths[-1]), 3),
        "bearing_last_deg": round(float(-azimuths[0]), 3),
        "beams_evened": fan.beams is not None,
        "columns": reading.columns(port_first=False),
        "doubts": [
            *([] if reading.device else [HEIGHT_UNKNOWN.format(ELEVATION_DEG)]),
            *([SEAT_UNKNOWN] if reading.unseated else []),
        ],
        "poses": "none",
    }


def _finite(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


def _warn(path: Path | None, message: str) -> None:
    text = message if path is None else f"{path}: {message}"
    warnings.warn(text, RecordingWarning, stacklevel=3)
