"""Pictures of a vehicle's flight, as PNG bytes."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from insonify.frames import wrapped
from insonify.mission.account import Account
from insonify.report.fans import INK, png
from insonify.report.pictures import draw_ground
from insonify.types import Float64, Pose
from insonify.vehicle.craft import Moment

TRUE, ESTIMATED, PLANNED = "#2a9d57", "#d1495b", "#3066be"


def draw_tracks(account: Account, moments: list[Moment]) -> bytes:
    """The true, estimated and planned track from above and from the side in time."""
    figure = Figure(figsize=(10.2, 5.6), layout="constrained")
    above, aside = figure.subplots(1, 2, width_ratios=(1.5, 1))
    draw_ground(above, account)
    time_s = [moment.time_s for moment in moments]
    tracks = (
        ("planned", PLANNED, "--", [moment.planned for moment in moments]),
        ("true", TRUE, "-", [moment.true for moment in moments]),
        ("estimated", ESTIMATED, "-", [moment.estimated for moment in moments]),
    )
    for name, colour, style, poses in tracks:
        places = _places(poses)
        above.plot(places[:, 0], places[:, 1], style, color=colour, lw=1.1, label=name)
        aside.plot(time_s, places[:, 2], style, color=colour, lw=1.0, label=name)
    above.plot(*_places([moments[0].true])[0, :2], "o", color=INK, ms=5)
    above.legend(fontsize=8)
    aside.set(xlabel="time, s", title="height z, m")
    aside.title.set_fontsize(9)
    aside.grid(alpha=0.3)
    return png(figure)


def draw_pose_errors(moments: list[Moment]) -> bytes:
    """Errors of position and attitude in time, with the two standard deviations of the filter."""
    figure = Figure(figsize=(10.2, 4.6), layout="constrained")
    time_s = [moment.time_s for moment in moments]
    errors = _places([m.estimated for m in moments]) - _places([m.true for m in moments])
    angles = [
        [
            math.degrees(wrapped(after - before))
            for after, before in zip(_angles(m.estimated), _angles(m.true), strict=True)
        ]
        for m in moments
    ]
    spread = np.array(
        [np.zeros(6) if m.covariance is None else np.sqrt(np.diag(m.covariance)) for m in moments]
    )
    spread[:, 3:] = np.degrees(spread[:, 3:])
    values = np.hstack([errors, np.array(angles)])
    titles = ("x, m", "y, m", "z, m", "roll, deg", "pitch, deg", "heading, deg")
    for k, axes in enumerate(figure.subplots(2, 3, sharex=True).ravel()):
        axes.fill_between(time_s, -2 * spread[:, k], 2 * spread[:, k], color="#c9d6df", lw=0)
        axes.plot(time_s, values[:, k], color=ESTIMATED, lw=1.0)
        axes.set_title(f"estimated - true {titles[k]}", fontsize=9, color=INK)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        if k > 2:
            axes.set_xlabel("time, s", fontsize=8)
    return png(figure)


def _places(poses: list[Pose]) -> Float64:
    return np.array([pose.position_m for pose in poses])


def _angles(pose: Pose) -> tuple[float, float, float]:
    return (pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
