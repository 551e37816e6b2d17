"""Following a route: a target that moves along it, and the filter that makes it a set point."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.frames import wrapped
from insonify.types import Pose
from insonify.vehicle.autopilot.control import SetPoint


class GuidanceSettings(Settings):
    """How a route is flown."""

    speed_m_s: float = Field(0.5, gt=0, le=5, description="along the route")
    acceleration_m_s2: float = Field(0.15, gt=0, le=5, description="to that speed and from it")
    turn_deg_s: float = Field(20.0, gt=0, le=180, description="fastest change of heading")
    filter_rad_s: float = Field(2.0, gt=0, le=10, description="of the set-point filter")
    patience_m: float = Field(
        1.0, gt=0, le=100, description="the target waits for a vehicle that is so far behind"
    )


class Follower:
    """A set point that moves along a route at a set speed and heading, and waits for the vehicle.

    The target keeps to the legs; the set point follows it as a critically damped second-order
    filter with the target's velocity fed forward, so that it rounds corners without steps in its
    velocity and does not lag on straight legs.
    """

    def __init__(self, settings: GuidanceSettings, start: Pose) -> None:
        """Hold a pose until there is a route."""
        self._settings = settings
        self._place = np.array(start.position_m)
        self._velocity = np.zeros(3)
        self._yaw, self._yaw_rate = start.yaw_rad, 0.0
        self.hold(start)

    def hold(self, pose: Pose) -> None:
        """Go to a pose in a straight line at once, and stay: the target jumps, the filter not."""
        self._set([pose, pose])
        self._target_yaw = pose.yaw_rad

    def follow(self, route: tuple[Pose, ...]) -> None:
        """Fly a route from where the target now is."""
        x, y, z = (float(c) for c in self._target())
        self._set([Pose(x, y, z, yaw_rad=self._target_yaw), *route])

    @property
    def finished(self) -> bool:
        """Whether the target has reached the end of the route."""
        return self._along >= self._length and abs(wrapped(self._goal_yaw() - self._yaw)) < 0.02

    @property
    def set_point(self) -> SetPoint:
        """Where the vehicle should be now."""
        return self._set_point

    def remaining(self) -> tuple[Pose, ...]:
        """The waypoints still ahead."""
        return tuple(self._route[self._leg + 1 :])

    def step(self, position_m: np.ndarray, period_s: float) -> SetPoint:
        """Move on by a period; ``position_m`` is where the vehicle believes it is."""
        settings = self._settings
        self._advance(position_m, period_s)
        target = self._target()
        ahead = self._direction() * self._speed
        w = settings.filter_rad_s
        acceleration = w * w * (target - self._place) + 2.0 * w * (ahead - self._velocity)
        self._velocity = self._velocity + period_s * acceleration
        self._place = self._place + period_s * self._velocity
        most = math.radians(settings.turn_deg_s)
        turn = wrapped(self._goal_yaw() - self._target_yaw)
        step = max(-most * period_s, min(most * period_s, turn))
        self._target_yaw = wrapped(self._target_yaw + step)
        swing = w * w * wrapped(self._target_yaw - self._yaw)
        swing += 2.0 * w * (step / period_s - self._yaw_rate)
        self._yaw_rate += period_s * swing
        self._yaw = wrapped(self._yaw + period_s * self._yaw_rate)
        self._set_point = SetPoint(
            self._place, self._velocity, acceleration, self._yaw, self._yaw_rate, swing
        )
        return self._set_point

    def _set(self, route: list[Pose]) -> None:
        self._route = route
        self._points = np.array([pose.position_m for pose in route])
        lengths = np.linalg.norm(np.diff(self._points, axis=0), axis=1)
        self._starts = np.concatenate([[0.0], np.cumsum(lengths)])
        self._length = float(self._starts[-1])
        self._along, self._speed, self._leg = 0.0, 0.0, 0
        self._set_point = SetPoint(
            self._place, self._velocity, np.zeros(3), self._yaw, self._yaw_rate, 0.0
        )

    def _advance(self, position_m: np.ndarray, period_s: float) -> None:
        """Move the target along: trapezoidal speed, none while the vehicle is far behind."""
        settings = self._settings
        left = self._length - self._along
        behind = float(np.linalg.norm(self._place - position_m)) > settings.patience_m
        fastest = 0.0 if behind else settings.speed_m_s
        fastest = min(fastest, math.sqrt(2.0 * settings.acceleration_m_s2 * max(left, 0.0)))
        change = settings.acceleration_m_s2 * period_s
        self._speed = min(self._speed + change, max(self._speed - 4.0 * change, fastest))
        self._along = min(self._length, self._along + self._speed * period_s)
        if left <= 1e-3:
            self._along, self._speed = self._length, 0.0
        last = len(self._starts) - 2
        while self._leg < last and self._along >= self._starts[self._leg + 1]:
            self._leg += 1

    def _target(self) -> np.ndarray:
        start, end = self._points[self._leg], self._points[self._leg + 1]
        length = float(self._starts[self._leg + 1] - self._starts[self._leg])
        share = (self._along - float(self._starts[self._leg])) / length if length > 0.0 else 1.0
        reached: np.ndarray = start + min(1.0, share) * (end - start)
        return reached

    def _direction(self) -> np.ndarray:
        gap = self._points[self._leg + 1] - self._points[self._leg]
        length = float(np.linalg.norm(gap))
        return gap / length if length > 0.0 else np.zeros(3)

    def _goal_yaw(self) -> float:
        return self._route[self._leg + 1].yaw_rad


def route_length_m(route: tuple[Pose, ...]) -> float:
    """Length of the straight legs of a route."""
    return sum(math.dist(a.position_m, b.position_m) for a, b in pairwise(route))
