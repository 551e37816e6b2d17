"""A vehicle's track as a plain table: where it was, believed to be and was meant to be."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from insonify.types import Pose
from insonify.vehicle.craft import Track

_SIX = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
_ERRORS = ("x", "y", "z", "roll", "pitch", "yaw")
COLUMNS = (
    "time_s",
    *(f"true_{name}" for name in _SIX),
    *(f"estimated_{name}" for name in _SIX),
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
            row = [moment.time_s, *_row(moment.true), *_row(moment.estimated)]
            row += [*planned.position_m, float(np.degrees(planned.yaw_rad))]
            row += [float(value) for value in covariance[upper]]
            writer.writerow(f"{value:.9g}" for value in row)


def _row(pose: Pose) -> list[float]:
    angles = np.degrees([pose.roll_rad, pose.pitch_rad, pose.yaw_rad])
    return [*pose.position_m, *(float(angle) for angle in angles)]
