"""A vehicle's track as a plain table: where it was, believed to be and was meant to be."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.types import Pose
from insonify.vehicle.craft import Moment, Track

POSE_COLUMNS = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
_ERRORS = ("x", "y", "z", "roll", "pitch", "yaw")
COLUMNS = (
    "time_s",
    *(f"true_{name}" for name in POSE_COLUMNS),
    *(f"estimated_{name}" for name in POSE_COLUMNS),
    *(f"planned_{name}" for name in ("x_m", "y_m", "z_m", "yaw_deg")),
    *(f"cov_{a}_{b}" for k, a in enumerate(_ERRORS) for b in _ERRORS[k:]),
)
"""The covariance's upper triangle: position (m, world frame) and attitude (rad, body frame)."""


def save_track(track: Track, path: Path) -> None:
    """Write a track as CSV with the `COLUMNS`; under perfect navigation the covariance is 0."""
    upper = np.triu_indices(6)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for moment in track.moments:
            planned = moment.planned
            covariance = np.zeros((6, 6)) if moment.covariance is None else moment.covariance
            row = [moment.time_s, *pose_row(moment.true), *pose_row(moment.estimated)]
            row += [*planned.position_m, float(np.degrees(planned.yaw_rad))]
            row += [float(value) for value in covariance[upper]]
            writer.writerow(f"{value:.9g}" for value in row)


def load_track(path: Path) -> tuple[Moment, ...]:
    """Read the moments of a track that `save_track` wrote.

    Raises:
        RecordingError: The file is missing, or a line is not what it should be.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = csv.reader(file)
            head = next(lines, [])
            rows = [[float(word) for word in line] for line in lines]
    except (OSError, ValueError, csv.Error) as err:
        raise RecordingError(f"{path}: cannot be read as a track ({reason(err)})") from err
    if tuple(head) != COLUMNS or any(len(row) != len(COLUMNS) for row in rows):
        raise RecordingError(f"{path}: no track of a vehicle; its columns are not ours")
    return tuple(_moment(row) for row in rows)


def _moment(row: list[float]) -> Moment:
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = row[17:]
    covariance += np.triu(covariance, 1).T
    x_m, y_m, z_m, yaw_deg = row[13:17]
    return Moment(
        row[0],
        _pose(row[1:7]),
        _pose(row[7:13]),
        Pose(x_m, y_m, z_m, yaw_rad=math.radians(yaw_deg)),
        covariance if covariance.any() else None,
    )


def pose_row(pose: Pose) -> list[float]:
    """A pose as the `POSE_COLUMNS`."""
    angles = (math.degrees(a) for a in (pose.roll_rad, pose.pitch_rad, pose.yaw_rad))
    return [*pose.position_m, *angles]


def _pose(row: list[float]) -> Pose:
    return Pose(*row[:3], *map(math.radians, row[3:]))
