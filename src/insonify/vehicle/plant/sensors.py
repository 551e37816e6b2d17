"""What the vehicle measures: IMU, Doppler log, depth and compass, each with errors of its own.

Every sensor draws its noise from the generator it is given; errors that stay (biases, the log's
scale) are drawn once.  Rates: the IMU's is that of the integrator, the others sample on the
control's clock.
"""

from __future__ import annotations

import math

import numpy as np

from insonify.types import Float64
from insonify.vehicle.instruments import (
    CompassSettings,
    DepthSettings,
    DvlSettings,
    ImuSettings,
    RayQuery,
    beam_directions,
)


class Imu:
    """Adds noise and wandering biases to ideal readings."""

    def __init__(self, settings: ImuSettings, rng: np.random.Generator) -> None:
        """Draw the biases of the start."""
        self._rng = rng
        root_rate = math.sqrt(settings.rate_hz)
        force, rate = settings.accel_noise * root_rate, settings.gyro_noise * root_rate
        self._noise = np.repeat([force, rate], 3)
        walk_force, walk_rate = settings.accel_walk / root_rate, settings.gyro_walk / root_rate
        self._walk = np.repeat([walk_force, walk_rate], 3)
        spread = np.repeat([settings.accel_bias_m_s2, settings.gyro_bias_rad_s], 3)
        self.bias = spread * rng.standard_normal(6)

    def sample(self, ideal: Float64) -> Float64:
        """Readings (samples, 6), specific force and turn rate, of the ideal ones."""
        noise = self._rng.standard_normal((2, *ideal.shape))
        bias = self.bias + np.cumsum(noise[0] * self._walk, axis=0)
        self.bias = bias[-1]
        readings: Float64 = ideal + bias + noise[1] * self._noise
        return readings


class Dvl:
    """Velocities along four beams, where they find a bottom.

    Attributes:
        scale: The share by which it reads too much.
        beams: Unit vectors (4, 3) along the beams, body frame.
        ranges_m: (4,) of the last sample, not a number without an echo.
    """

    def __init__(self, settings: DvlSettings, rng: np.random.Generator) -> None:
        """Draw the scale error."""
        self._settings = settings
        self._rng = rng
        self.scale = settings.scale * float(rng.standard_normal())
        self.beams = beam_directions(settings)
        self.ranges_m = np.full(4, np.nan)
        self._square = math.cos(math.radians(settings.steepest_deg))

    def sample(
        self, position_m: Float64, turn: Float64, velocity: Float64, rate: Float64, look: RayQuery
    ) -> Float64:
        """Beam velocities (4,) m/s, not a number without an echo.

        Args:
            position_m: (3,) of the body, world.
            turn: (3, 3) world from body.
            velocity: (3,) m/s of the body's origin, body frame.
            rate: (3,) rad/s, body frame.
            look: Finds the bottom.
        """
        arm = np.array(self._settings.position_m)
        noise = self._settings.noise_m_s * self._rng.standard_normal(4)
        there = velocity + np.cross(rate, arm)
        readings: Float64 = (1.0 + self.scale) * (self.beams @ there) + noise
        range_m, square = look(position_m + turn @ arm, (self.beams @ turn.T).astype(np.float32))
        near, far = self._settings.range_min_m, self._settings.range_max_m
        lost = (range_m < near) | (range_m > far) | (square < self._square)
        readings[lost] = np.nan
        self.ranges_m = np.where(lost, np.nan, range_m)
        return readings


class Compass:
    """Heading with noise and a Gauss-Markov deviation."""

    def __init__(self, settings: CompassSettings, rng: np.random.Generator) -> None:
        """Draw the deviation of the start."""
        self._rng = rng
        self._noise = math.radians(settings.noise_deg)
        spread = math.radians(settings.deviation_deg)
        self._stay = math.exp(-1.0 / (settings.rate_hz * settings.deviation_s))
        self._kick = spread * math.sqrt(1.0 - self._stay**2)
        self.deviation = spread * float(rng.standard_normal())

    def sample(self, yaw_rad: float) -> float:
        """A reading of a heading."""
        kick, noise = self._rng.standard_normal(2)
        self.deviation = self._stay * self.deviation + self._kick * float(kick)
        return yaw_rad + self.deviation + self._noise * float(noise)


class Depth:
    """Height below the surface, world z, with noise."""

    def __init__(self, settings: DepthSettings, rng: np.random.Generator) -> None:
        """A sensor."""
        self._rng, self._noise = rng, settings.noise_m

    def sample(self, z_m: float) -> float:
        """A reading."""
        return z_m + self._noise * float(self._rng.standard_normal())
