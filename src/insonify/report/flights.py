"""Pictures of a vehicle's flight, as PNG bytes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insonify.frames import wrapped
from insonify.mission.account import Account
from insonify.report.colours import BLUE, INK, ORANGE
from insonify.report.fans import png
from insonify.report.pictures import draw_ground
from insonify.types import Float64, Pose
from insonify.vehicle.craft import Moment

TRUE, ESTIMATED, PLANNED = INK, ORANGE, BLUE
_TITLES = ("x, m", "y, m", "z, m", "roll, degrees", "pitch, degrees", "heading, degrees")


def draw_tracks(account: Account, moments: list[Moment]) -> list[bytes]:
    """The true, estimated and planned track from above, and their height in time."""
    time_s = [moment.time_s for moment in moments]
    tracks: tuple[tuple[str, dict[str, Any], list[Pose]], ...] = (
        ("planned", {"color": PLANNED, "ls": "--"}, [moment.planned for moment in moments]),
        ("true", {"color": TRUE}, [moment.true for moment in moments]),
        ("estimated", {"color": ESTIMATED}, [moment.estimated for moment in moments]),
    )
    figures = [Figure(figsize=(5.4, 4.4), layout="constrained") for _ in range(2)]
    above, aside = (figure.add_subplot() for figure in figures)
    draw_ground(above, account)
    for name, style, poses in tracks:
        places = _places(poses)
        above.plot(places[:, 0], places[:, 1], lw=1.3, label=name, **style)
        aside.plot(time_s, places[:, 2], lw=1.2, label=name, **style)
    above.plot(*_places([moments[0].true])[0, :2], "o", color=INK, ms=5)
    for axes in (above, aside):
        axes.legend(fontsize=9)
    aside.set(xlabel="time, s", ylabel="z (up), m")
    aside.ticklabel_format(useOffset=False)
    _plain(aside)
    return [png(figure) for figure in figures]


def draw_pose_errors(moments: list[Moment]) -> list[tuple[str, bytes]]:
    """Errors of position and attitude in time, with the two standard deviations of the filter."""
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
    drawn = []
    for name, error, two in zip(
        _TITLES, np.hstack([errors, np.array(angles)]).T, 2 * spread.T, strict=True
    ):
        figure = Figure(figsize=(3.7, 2.3), layout="constrained")
        axes = figure.add_subplot()
        axes.fill_between(time_s, -two, two, color="#c9d6df", lw=0)
        axes.plot(time_s, error, color=ESTIMATED, lw=1.2)
        axes.set_xlabel("time, s", fontsize=9)
        _plain(axes)
        drawn.append((name, png(figure)))
    return drawn


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def _places(poses: list[Pose]) -> Float64:
    return np.array([pose.position_m for pose in poses])


def _angles(pose: Pose) -> tuple[float, float, float]:
    return (pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
