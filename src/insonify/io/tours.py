"""The pings of a tour as files: images by sonar, and one table of when and where."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from insonify.io.pings import save_sweep
from insonify.sonar.scanning import deskewed_image, polar_image
from insonify.tours import MountedSonar, Sounding, turns_of
from insonify.types import Pose

_SIX = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
COLUMNS = (
    "time_s",
    "sonar",
    "number",
    "head_deg",
    *(f"true_{name}" for name in _SIX),
    *(f"estimated_{name}" for name in _SIX),
)


def save_soundings(soundings: Sequence[Sounding], folder: Path) -> None:
    """Write ``pings.csv``, the `COLUMNS` of every ping, and ``SONAR.npz`` for each sonar.

    An archive holds, in the order of its pings: ``images`` (pings, bins, beams) float32, ``time_s``
    and ``head_rad`` (pings,), ``true_pose`` and ``estimated_pose`` (pings, 6) of the vehicle and
    ``mount`` (pings, 6) of the sonar on it, x, y, z (m), roll, pitch, yaw (rad); and ``fan``:
    azimuth and elevation field of view (rad), least and greatest range (m).
    """
    with (folder / "pings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for one in soundings:
            numbers = [*_row(one.true), *_row(one.estimated)]
            head = f"{math.degrees(one.head_rad):.9g}"
            writer.writerow(
                [f"{one.ping.time_s:.9g}", one.sonar, one.number, head]
                + [f"{value:.9g}" for value in numbers]
            )
    for name in dict.fromkeys(one.sonar for one in soundings):
        own = [one for one in soundings if one.sonar == name]
        fan = own[0].ping.geometry
        with (folder / f"{name}.npz").open("wb") as file:
            np.savez_compressed(
                file,
                images=np.stack([one.ping.image for one in own]),
                time_s=np.array([one.ping.time_s for one in own]),
                head_rad=np.array([one.head_rad for one in own]),
                true_pose=np.array([_six(one.true) for one in own]),
                estimated_pose=np.array([_six(one.estimated) for one in own]),
                mount=np.array([_six(one.ping.geometry.mount) for one in own]),
                fan=np.array(
                    [
                        fan.azimuth_fov_rad,
                        fan.elevation_fov_rad,
                        fan.range_min_m,
                        fan.range_max_m,
                    ]
                ),
            )


def save_turns(soundings: Sequence[Sounding], mounted: MountedSonar, folder: Path) -> None:
    """Write each whole turn of a scanning head; its poses are those of the head's base."""
    for number, turn in enumerate(turns_of(soundings, mounted)):
        polar = polar_image(turn, mounted.sonar)
        deskewed = deskewed_image(turn, mounted.sonar, turn[0].pose)
        path = folder / f"{mounted.name}-{number:05d}.npz"
        save_sweep(path, tuple(turn), polar, deskewed, ())


def _six(pose: Pose) -> list[float]:
    return [*pose.position_m, pose.roll_rad, pose.pitch_rad, pose.yaw_rad]


def _row(pose: Pose) -> list[float]:
    x, y, z, *angles = _six(pose)
    return [x, y, z, *map(math.degrees, angles)]
