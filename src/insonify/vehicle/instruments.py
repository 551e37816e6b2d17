"""The vehicle's instruments as their makers tell of them: rates, errors, beams.

The plant draws errors of these sizes; the filter knows the sizes, not the errors.  The figures are
those of small vehicles' instruments: a MEMS IMU, a Doppler log of 0.1 % and 1 mm/s, a magnetic
compass after calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.frames import directions_from_angles
from insonify.types import Float32, Float64, Pose, estimated
from insonify.vehicle.description import Vector

RayQuery = Callable[[Float64, Float32], tuple[Float64, Float64]]
"""The world's answer to rays (origin (3,), unit directions (N, 3)): range in metres (N,), infinite
where nothing is met, and the cosine of the angle to the normal of what is (N,)."""


class PoseNoiseSettings(Settings):
    """How far poses are off without a vehicle, each ping's by itself; the mapper is told so."""

    position_m: float = Field(0.0, ge=0, le=10, description="standard deviation of each coordinate")
    attitude_deg: float = Field(0.0, ge=0, le=45, description="and of roll, pitch and yaw")


def doubtful(noise: PoseNoiseSettings, rng: np.random.Generator, pose: Pose) -> Pose:
    """What a pose is taken for, with how far it may be off."""
    std = noise.position_m, math.radians(noise.attitude_deg)
    if not any(std):
        return pose
    off = rng.standard_normal(6) * np.repeat(std, 3)
    return estimated(Pose(*(np.array(pose.numbers) + off).tolist()), std)


class ImuSettings(Settings):
    """Rate gyros and accelerometers."""

    rate_hz: int = Field(100, ge=20, le=1000, multiple_of=20, description="and the integrator's")
    gyro_noise: float = Field(9e-5, gt=0, le=1, description="density, rad/s per root Hz")
    gyro_bias_rad_s: float = Field(5e-4, gt=0, le=1, description="standard deviation at the start")
    gyro_walk: float = Field(1e-6, gt=0, le=1, description="of the bias, rad/s per root s")
    accel_noise: float = Field(1e-3, gt=0, le=10, description="density, m/s2 per root Hz")
    accel_bias_m_s2: float = Field(0.02, gt=0, le=10, description="standard deviation at the start")
    accel_walk: float = Field(1e-4, gt=0, le=1, description="of the bias, m/s2 per root s")


class DvlSettings(Settings):
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


class DepthSettings(Settings):
    """A pressure sensor; its reading is the height of the vehicle's origin."""

    rate_hz: float = Field(10.0, gt=0, le=20)
    noise_m: float = Field(0.01, gt=0, le=10)


class CompassSettings(Settings):
    """A heading reference: noise, and a deviation that wanders."""

    rate_hz: float = Field(10.0, gt=0, le=20)
    noise_deg: float = Field(0.5, gt=0, le=30)
    deviation_deg: float = Field(0.5, gt=0, le=30, description="standard deviation")
    deviation_s: float = Field(600.0, gt=0, le=1e6, description="its correlation time")


class SensorSettings(Settings):
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


def beam_directions(settings: DvlSettings) -> Float64:
    """Unit vectors (4, 3) of a log's beams, body frame: ahead left, ahead right, and behind."""
    azimuth = np.radians([45.0, -45.0, -135.0, 135.0])
    down = np.full(4, math.radians(settings.beam_deg) - math.pi / 2)
    return directions_from_angles(azimuth, down)
