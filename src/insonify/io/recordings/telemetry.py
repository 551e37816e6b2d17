"""Telemetry logs of ArduSub and its kin (``.tlog``) as poses, read with pymavlink.

Attitude and local position are told apart, each at its own rate and with the autopilot's time since
it started; the position is interpolated to the times of the attitudes.  The clock of the log is
that of the computer that wrote it: the autopilot's start is the least of the differences of the
two, as messages are late but never early.
"""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.extras import optional
from insonify.frames import enu_from_ned, quaternion_from_rotation, transform_from_pose
from insonify.limits import MOST_LOG_BYTES
from insonify.types import Float64, Pose

_ATTITUDE, _POSITION = "ATTITUDE", "LOCAL_POSITION_NED"
_NO_AUTOPILOT = 8
_EARLIEST_S, _LATEST_S = 9e8, 4e9
_DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    struct.error,
    ArithmeticError,
)
"""What pymavlink raises on damaged logs."""


def read_telemetry(path: Path) -> Float64:
    """Rows (N, 8) of time since 1970 and pose of a telemetry log, in our axes.

    Raises:
        RecordingError: It is missing, or no vehicle tells its attitude and local position in it.
        MissingExtraError: pymavlink is not installed.
    """
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such telemetry log; check the path")
    if path.stat().st_size > MOST_LOG_BYTES:
        raise RecordingError(f"{path}: larger than 1 GiB, so not a telemetry log")
    mavutil = optional("pymavlink.mavutil", "mavlink", "a telemetry log (.tlog)")
    try:
        told = _messages(mavutil, path)
    except _DAMAGE as err:
        raise RecordingError(f"{path}: damaged, or not a telemetry log ({reason(err)})") from err
    attitudes, places = _of_the_vehicle(path, told)
    start_s = _start(attitudes, places)
    times = attitudes[:, 1]
    inside = (times >= places[0, 1]) & (times <= places[-1, 1])
    if not inside.any():
        raise RecordingError(f"{path}: attitudes and positions are of different times")
    rows = []
    spots = np.column_stack([np.interp(times, places[:, 1], places[:, 2 + k]) for k in range(3)])
    for attitude, spot in zip(attitudes[inside], spots[inside], strict=True):
        north, east, down = map(float, spot)
        pose = enu_from_ned(Pose(north, east, down, *map(float, attitude[2:5])))
        quaternion = quaternion_from_rotation(transform_from_pose(pose)[:3, :3])
        rows.append([start_s + attitude[1], *pose.position_m, *quaternion])
    return np.array(rows)


def _messages(mavutil: Any, path: Path) -> dict[str, list[list[float]]]:
    """Rows of each kind: system, stamp, seconds since start, and three numbers."""
    told: dict[str, list[list[float]]] = {_ATTITUDE: [], _POSITION: [], "HEARTBEAT": []}
    log = mavutil.mavlogfile(str(path))
    try:
        while (message := log.recv_match(type=list(told))) is not None:
            kind, system = message.get_type(), float(message.get_srcSystem())
            if kind == "HEARTBEAT":
                told[kind].append([system, float(message.autopilot)])
                continue
            names = ("roll", "pitch", "yaw") if kind == _ATTITUDE else ("x", "y", "z")
            numbers = [float(getattr(message, name)) for name in names]
            row = [system, float(message._timestamp), 1e-3 * message.time_boot_ms, *numbers]
            if np.isfinite(row).all() and _EARLIEST_S < row[1] < _LATEST_S:
                told[kind].append(row)
    finally:
        log.close()
    return told


def _of_the_vehicle(path: Path, told: dict[str, list[list[float]]]) -> tuple[Float64, Float64]:
    """Attitudes and positions of the system that flies: stamp, seconds since start, numbers."""
    systems = Counter(row[0] for row in told[_POSITION])
    autopilots = {row[0] for row in told["HEARTBEAT"] if row[1] != _NO_AUTOPILOT}
    likely = [system for system, _ in systems.most_common() if system in autopilots]
    system = next(iter(likely or systems), None)
    tables = []
    for kind in (_ATTITUDE, _POSITION):
        rows = np.array([row[1:] for row in told[kind] if row[0] == system]).reshape(-1, 5)
        if len(rows) < 2:
            raise RecordingError(
                f"{path}: no vehicle tells both its attitude and its local position (ATTITUDE, "
                "LOCAL_POSITION_NED) in it, so there are no poses"
            )
        _, first = np.unique(rows[:, 1], return_index=True)
        tables.append(rows[first])
    return tables[0], tables[1]


def _start(attitudes: Float64, places: Float64) -> float:
    """When the autopilot started, since 1970; a few damaged stamps do not matter."""
    late = np.concatenate([table[:, 0] - table[:, 1] for table in (attitudes, places)])
    near = late[abs(late - np.median(late)) < 60.0]
    return float(near.min())
