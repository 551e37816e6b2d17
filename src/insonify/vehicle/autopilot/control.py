"""Control of surge, sway, heave and yaw by PID, in the vehicle's frame.

Gains come from the vehicle's own mass: an axis of mass m (rigid and added) gets the stiffness
m w^2 and the damping 2 m w of a critically damped oscillator of natural frequency w (Fossen 2011,
section 12.2), and integral action at the rate w_i: m w^2 w_i.  The feed-forward is the mass times
the set point's acceleration, the damping at its speed, and the weight that buoyancy leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.frames import wrapped
from insonify.types import Float64
from insonify.vehicle.autopilot.allocation import CONTROLLED, Allocator
from insonify.vehicle.description import VehicleDescription
from insonify.vehicle.model import hydro


class ControlSettings(Settings):
    """How stiffly a vehicle is held."""

    position_rad_s: float = Field(
        1.5, gt=0, le=5, description="natural frequency of surge, sway and heave"
    )
    yaw_rad_s: float = Field(2.0, gt=0, le=5, description="natural frequency of yaw")
    integral_per_s: float = Field(0.4, ge=0, le=2, description="rate of integral action")


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How the vehicle moves, by its own estimate.

    Attributes:
        position_m: (3,) world.
        velocity_m_s: (3,) world.
        turn: (3, 3) ``world_from_body``.
        rate_rad_s: (3,) body.
        yaw_rad: Heading.
    """

    position_m: Float64
    velocity_m_s: Float64
    turn: Float64
    rate_rad_s: Float64
    yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class SetPoint:
    """Where the vehicle should be now, and how it should be moving: world frame and heading."""

    position_m: Float64
    velocity_m_s: Float64
    acceleration_m_s2: Float64
    yaw_rad: float
    yaw_rate_rad_s: float
    yaw_acceleration_rad_s2: float


class Controller:
    """PID with feed-forward; the integral gives way where the thrusters have no more to give."""

    def __init__(
        self, vehicle: VehicleDescription, settings: ControlSettings, density_kg_m3: float
    ) -> None:
        """A controller at rest."""
        model = hydro(vehicle, density_kg_m3)
        axes = list(CONTROLLED)
        frequency = np.array([settings.position_rad_s] * 3 + [settings.yaw_rad_s])
        self._mass = np.diag(model.rigid + model.added)[axes]
        self._linear, self._quadratic = model.linear[axes], model.quadratic[axes]
        self._stiffness = self._mass * frequency**2
        self._damping = 2.0 * self._mass * frequency
        self._integral_gain = self._stiffness * settings.integral_per_s
        self._surplus_n = float(model.weights_n[0] - model.weights_n[1])
        self._allocator = Allocator(model.directions, model.limits[0])
        self._integral = np.zeros(4)  # of the error: position in the world frame, then yaw

    def thrusts(self, motion: Motion, goal: SetPoint, period_s: float) -> Float64:
        """The thrusts (thrusters,) N that bring the vehicle to its set point."""
        turn = motion.turn
        error, slip, wind = np.empty(4), np.empty(4), np.empty(4)
        velocity, acceleration = np.empty(4), np.empty(4)
        away = goal.position_m - motion.position_m
        error[:3] = away @ turn
        error[3] = wrapped(goal.yaw_rad - motion.yaw_rad)
        velocity[:3] = goal.velocity_m_s @ turn
        velocity[3] = goal.yaw_rate_rad_s
        acceleration[:3] = goal.acceleration_m_s2 @ turn
        acceleration[3] = goal.yaw_acceleration_rad_s2
        slip[:3] = (goal.velocity_m_s - motion.velocity_m_s) @ turn
        slip[3] = goal.yaw_rate_rad_s - motion.rate_rad_s[2]
        wind[:3] = self._integral[:3] @ turn
        wind[3] = self._integral[3]
        forward = self._mass * acceleration
        forward += (self._linear + self._quadratic * np.abs(velocity)) * velocity
        forward[:3] += self._surplus_n * turn[2]
        wanted = (
            forward + self._stiffness * error + self._damping * slip + self._integral_gain * wind
        )
        thrusts, given = self._allocator.share(wanted)
        # anti-windup by back-calculation: what could not be given is taken out of the integral
        excess = (given - wanted) / self._stiffness
        self._integral[:3] += period_s * (away + turn @ excess[:3])
        self._integral[3] += period_s * (error[3] + excess[3])
        return thrusts


def settled(motion: Motion, goal: SetPoint, within_m: float, within_rad: float) -> bool:
    """Whether a vehicle is where it should be, by its own motion."""
    away = math.dist(goal.position_m.tolist(), motion.position_m.tolist())
    return away < within_m and abs(wrapped(goal.yaw_rad - motion.yaw_rad)) < within_rad
