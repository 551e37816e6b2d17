"""Poses over time: TUM files, and interpolation to the time of a ping."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.frames import (
    enu_from_ned,
    pose_from_quaternion,
    quaternion_from_rotation,
    slerp,
    transform_from_pose,
)
from insonify.types import Float64, Pose, estimated

MOST_POSE_FILE_BYTES = 1 << 30


_STEPS_A_GAP, _LEAST_GAP_S, _LEAST_JUMP_MPS = 5.0, 1.0, 5.0


class PoseTrack:
    """Poses in order of time; between two of them the position is linear and the turn even.

    Attributes:
        max_gap_s: Two poses further apart say nothing of the time between them.
        fastest_mps: Nor do two between which the vehicle would have been faster.
    """

    def __init__(
        self,
        rows: Float64,
        max_gap_s: float | None = None,
        std: Float64 | None = None,
        fastest_mps: float | None = None,
    ) -> None:
        """From rows (N, 8): seconds, x, y, z in metres, quaternion x, y, z, w.

        Args:
            rows: The poses.
            max_gap_s: By default five times the median time from pose to pose, a second at least;
                and then there is no pose either where the vehicle jumps, at five times its median
                speed and 5 m/s at least.
            std: (N, 2) how far each may be off, see `Pose.std`.
            fastest_mps: Where these are some of the poses, what all of them tell.

        Raises:
            ValueError: A number is not finite, a quaternion has no length, or time goes back.
        """
        if not np.isfinite(rows).all():
            raise ValueError("a pose holds a number that is not finite")
        lengths = np.linalg.norm(rows[:, 4:], axis=1)
        if (abs(lengths - 1.0) > 0.1).any():
            raise ValueError(
                f"quaternion {int(np.argmax(abs(lengths - 1.0))) + 1} has a length of "
                f"{lengths[np.argmax(abs(lengths - 1.0))]:.3g}, not 1"
            )
        if (np.diff(rows[:, 0]) < 0).any():
            raise ValueError("its times go back")
        self._std = np.zeros((len(rows), 2)) if std is None else std
        self._rows = rows.copy()
        self._rows[:, 4:] /= lengths[:, None]
        steps = np.diff(rows[:, 0])
        steps = steps[steps > 0.0]
        own = max(_LEAST_GAP_S, _STEPS_A_GAP * float(np.median(steps))) if len(steps) else 0.0
        self.max_gap_s = own if max_gap_s is None else max_gap_s
        if fastest_mps is None:
            fastest_mps = math.inf if max_gap_s is not None else _fastest(rows)
        self.fastest_mps = fastest_mps

    @classmethod
    def of(cls, poses: Iterable[tuple[float, Pose]], max_gap_s: float | None = None) -> PoseTrack:
        """From times in seconds and poses."""
        rows = []
        for time_s, pose in poses:
            rotation = transform_from_pose(pose)[:3, :3]
            rows.append([time_s, *pose.position_m, *quaternion_from_rotation(rotation)])
        return cls(np.array(rows, np.float64).reshape(-1, 8), max_gap_s)

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def times_s(self) -> Float64:
        """All times, (N,)."""
        return self._rows[:, 0]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time."""
        return float(self._rows[0, 0]), float(self._rows[-1, 0])

    def sample(self, number: int) -> Pose:
        """The pose of a row."""
        row = self._rows[number]
        return estimated(pose_from_quaternion(row[1:4], row[4:]), self._std[number])

    def at(self, time_s: float) -> Pose | None:
        """The pose at a time; None before the first, after the last, in a long gap or a jump."""
        times = self._rows[:, 0]
        after = int(np.searchsorted(times, time_s))
        if after < len(times) and times[after] == time_s:
            return self.sample(after)
        if after == 0 or after == len(times):
            return None
        start, end = self._rows[after - 1], self._rows[after]
        gap_s = float(end[0] - start[0])
        jump = float(np.linalg.norm(end[1:4] - start[1:4])) > self.fastest_mps * gap_s
        if gap_s > self.max_gap_s or jump:
            return None
        share = float((time_s - start[0]) / (end[0] - start[0]))
        position = (1.0 - share) * start[1:4] + share * end[1:4]
        std = (1.0 - share) * self._std[after - 1] + share * self._std[after]
        return estimated(pose_from_quaternion(position, slerp(start[4:], end[4:], share)), std)


def _fastest(rows: Float64) -> float:
    """The speed in m/s beyond which poses jump."""
    steps = np.diff(rows[:, 0])
    moves = np.linalg.norm(np.diff(rows[:, 1:4], axis=0), axis=1)[steps > 0.0]
    speeds = moves / steps[steps > 0.0]
    usual = float(np.median(speeds)) if len(speeds) else 0.0
    return max(_LEAST_JUMP_MPS, _STEPS_A_GAP * usual)


def is_pose(row: Sequence[float]) -> bool:
    """Whether time, position and quaternion, as in a row of `PoseTrack`, are those of a pose."""
    return bool(np.isfinite(row).all() and abs(np.linalg.norm(row[4:]) - 1.0) <= 0.1)


def is_telemetry(path: Path) -> bool:
    """Whether a file is a telemetry log, by its name: nothing in it says so."""
    return path.suffix.lower() == ".tlog"


def read_poses(path: Path, max_gap_s: float | None = None, *, ned: bool = False) -> PoseTrack:
    """A telemetry log (``.tlog``), which tells its axes, or a pose file in TUM format.

    That is ``time x y z qx qy qz qw`` a line, spaces or commas between.

    Lines that begin with ``#`` are left out, and so is a first line of names.

    Args:
        path: The file.
        max_gap_s: As in `PoseTrack`.
        ned: A TUM file's poses are north, east, down of a body forward, starboard, down.

    Raises:
        RecordingError: The file is missing, or a line is not eight numbers that make a pose.
    """
    if is_telemetry(path):
        from insonify.io.recordings.telemetry import read_telemetry

        return PoseTrack(read_telemetry(path), max_gap_s)
    rows = _tum_rows(path)
    try:
        track = PoseTrack(np.array(rows), max_gap_s)
        if ned:
            poses = (enu_from_ned(track.sample(number)) for number in range(len(track)))
            track = PoseTrack.of(zip(track.times_s, poses, strict=True), max_gap_s)
        return track
    except ValueError as err:
        raise RecordingError(f"{path}: {err}; each line is: time x y z qx qy qz qw") from err


def _tum_rows(path: Path) -> list[list[float]]:
    """The lines of a TUM file as rows of eight numbers, one at least."""
    try:
        if path.stat().st_size > MOST_POSE_FILE_BYTES:
            raise RecordingError(f"{path}: larger than 1 GiB, so not a pose file")
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError as err:
        raise RecordingError(f"{path}: there is no such pose file; check the path") from err
    except (OSError, UnicodeDecodeError) as err:
        raise RecordingError(f"{path}: cannot be read as a pose file ({reason(err)})") from err
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError as err:
            if not rows and not any(_is_number(word) for word in words):
                continue
            raise RecordingError(f"{path}, line {number}: not a number ({reason(err)})") from err
        if len(row) != 8:
            raise RecordingError(
                f"{path}, line {number}: {len(row)} numbers; a pose is eight: "
                "time x y z qx qy qz qw (TUM format)"
            )
        rows.append(row)
    if not rows:
        raise RecordingError(f"{path}: no poses in it; a line is: time x y z qx qy qz qw")
    return rows


def path_length_m(poses: Iterable[Pose]) -> float:
    """Length of the straight legs between poses."""
    return sum(math.dist(a.position_m, b.position_m) for a, b in pairwise(poses))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
