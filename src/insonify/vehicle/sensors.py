"""What the vehicle measures: IMU, Doppler log, depth and compass, each with errors of its own.

Every sensor draws its noise from the generator it is given; errors that stay (biases, the log's
scale) are drawn once.  Rates: the IMU's is that of the integrator, the others sample on the
control's clock.  The figures are those of small vehicles' instruments: a MEMS IMU, a Doppler log of
0.1 % and 1 mm/s, a magnetic compass after calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from insonify.frames import directions_from_angles
from insonify.types import Float32, Float64
from insonify.vehicle.description import Vector

Sounder = Callable[[Float64, Float32], tuple[Float64, Float64]]
"""The world's answer to rays (origin (3,), unit directions (N, 3)): range in metres (N,), infinite
where nothing is met, and the cosine of the angle to the normal of what is (N,)."""


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ImuSettings(_Settings):
    """Rate gyros and accelerometers."""

    rate_hz: int = Field(100, ge=20, le=1000, multiple_of=20, description="and the integrator's")
    gyro_noise: float = Field(9e-5, gt=0, le=1, description="density, rad/s per root Hz")
    gyro_bias_rad_s: float = Field(5e-4, gt=0, le=1, description="standard deviation at the start")
    gyro_walk: float = Field(1e-6, gt=0, le=1, description="of the bias, rad/s per root s")
    accel_noise: float = Field(1e-3, gt=0, le=10, description="density, m/s2 per root Hz")
    accel_bias_m_s2: float = Field(0.02, gt=0, le=10, description="standard deviation at the start")
    accel_walk: float = Field(1e-4, gt=0, le=1, description="of the bias, m/s2 per root s")


class DvlSettings(_Settings):
    """A Doppler log of four beams in an X, looking down."""

    rate_hz: float = Field(5.0, gt=0, le=20)
    beam_deg: float = Field(22.5, gt=0, lt=90, description="from the vertical")
    noise_m_s: float = Field(0.005, gt=0, le=10, description="of each beam's velocity")
    scale: float = Field(0.001, gt=0, le=0.1, description="standard deviation of the scale error")
    range_min_m: float = Field(0.1, ge=0)
    range_max_m: float = Field(50.0, gt=0, le=1000, description="no bottom lock beyond")
    steepest_deg: float = Field(
        65.0, gt=0, lt=90, description="no echo from ground farther off the beam's square"
    )
    position_m: Vector = Field((0.0, 0.0, -0.1), description="on the body")


class DepthSettings(_Settings):
    """A pressure sensor; its reading is the height of the vehicle's origin."""

    rate_hz: float = Field(10.0, gt=0, le=20)
    noise_m: float = Field(0.01, gt=0, le=10)


class CompassSettings(_Settings):
    """A heading reference: noise, and a deviation that wanders."""

    rate_hz: float = Field(10.0, gt=0, le=20)
    noise_deg: float = Field(0.5, gt=0, le=30)
    deviation_deg: float = Field(0.5, gt=0, le=30, description="standard deviation")
    deviation_s: float = Field(600.0, gt=0, le=1e6, description="its correlation time")


class SensorSettings(_Settings):
    """All that the vehicle navigates by."""

    imu: ImuSettings = ImuSettings()
    dvl: DvlSettings = DvlSettings()
    depth: DepthSettings = DepthSettings()
    compass: CompassSettings = CompassSettings()


class Clock:
    """When a sensor is due."""

    def __init__(self, rate_hz: float, start_s: float = 0.0) -> None:
        """Due at ``start_s`` and then every ``1 / rate_hz``."""
        self._period_s, self._start_s, self._count = 1.0 / rate_hz, start_s, 0

    def due(self, time_s: float) -> bool:
        """Whether a sample is due; asking takes it, and those that were missed before it."""
        if time_s < self._start_s + self._count * self._period_s - 1e-9:
            return False
        self._count = math.floor((time_s - self._start_s) / self._period_s + 1e-9) + 1
        return True


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
        self, position_m: Float64, turn: Float64, velocity: Float64, rate: Float64, sound: Sounder
    ) -> Float64:
        """Beam velocities (4,) m/s, not a number without an echo.

        Args:
            position_m: (3,) of the body, world.
            turn: (3, 3) world from body.
            velocity: (3,) m/s of the body's origin, body frame.
            rate: (3,) rad/s, body frame.
            sound: Finds the bottom.
        """
        arm = np.array(self._settings.position_m)
        noise = self._settings.noise_m_s * self._rng.standard_normal(4)
        there = velocity + np.cross(rate, arm)
        readings: Float64 = (1.0 + self.scale) * (self.beams @ there) + noise
        range_m, square = sound(position_m + turn @ arm, (self.beams @ turn.T).astype(np.float32))
        near, far = self._settings.range_min_m, self._settings.range_max_m
        lost = (range_m < near) | (range_m > far) | (square < self._square)
        readings[lost] = np.nan
        self.ranges_m = np.where(lost, np.nan, range_m)
        return readings


def beam_directions(settings: DvlSettings) -> Float64:
    """Unit vectors (4, 3) of a log's beams, body frame: ahead left, ahead right, and behind."""
    azimuth = np.radians([45.0, -45.0, -135.0, 135.0])
    down = np.full(4, math.radians(settings.beam_deg) - math.pi / 2)
    return directions_from_angles(azimuth, down)


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
