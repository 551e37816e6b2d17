"""Navigation: an error-state Kalman filter on IMU, Doppler log, depth and compass.

The IMU is integrated (strapdown); the filter keeps the covariance of the integral's error, and
corrects it with each reading of the others, one number at a time (Sola 2017, Quaternion kinematics
for the error-state Kalman filter, local angular error).  It starts from a known pose and knows the
sensors' figures, not their errors.

Error state: position 3, velocity 3 (world), attitude 3 (body), gyro bias 3, accelerometer bias 3,
compass deviation, Doppler scale.
"""

from __future__ import annotations

import math

import numpy as np

from insonify.frames import (
    attitude_from_pose,
    pose_from_attitude,
    rotation_from_attitude,
)
from insonify.jit import kernel
from insonify.kernels import cross, rotation_into
from insonify.types import Float64, Pose
from insonify.vehicle.autopilot.control import Motion
from insonify.vehicle.instruments import SensorSettings, beam_directions
from insonify.vehicle.model import GRAVITY_M_S2

STATES = 17
_START_M, _START_M_S, _START_RAD = 0.01, 0.01, math.radians(0.1)
P, V, A, GB, AB, CD, DS = 0, 3, 6, 9, 12, 15, 16


class Estimator:
    """Pose, velocity, sensor errors and their covariance, from measurements alone."""

    def __init__(self, settings: SensorSettings, start: Pose) -> None:
        """At rest at a start known to a centimetre and a tenth of a degree."""
        self._settings = settings
        self._beams = beam_directions(settings.dvl)
        self._arm = np.array(settings.dvl.position_m)
        self._rate = np.zeros(3)
        self.state = np.zeros(18)
        self.state[:3] = start.position_m
        self.state[6:10] = attitude_from_pose(start)
        spread = np.zeros(STATES)
        spread[P:V], spread[V:A], spread[A:GB] = _START_M, _START_M_S, _START_RAD
        spread[GB:AB] = settings.imu.gyro_bias_rad_s
        spread[AB:CD] = settings.imu.accel_bias_m_s2
        deviation = math.radians(settings.compass.deviation_deg)
        spread[CD], spread[DS] = deviation, settings.dvl.scale
        self.covariance = np.diag(spread**2)
        imu = settings.imu
        self._noise = np.array(
            [
                imu.accel_noise**2, imu.gyro_noise**2, imu.gyro_walk**2, imu.accel_walk**2,
                deviation**2, settings.compass.deviation_s,
            ]
        )  # fmt: skip

    @property
    def pose(self) -> Pose:
        """The estimated pose."""
        return pose_from_attitude(self.state[:3], self.state[6:10])

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation of the horizontal position along its worst direction."""
        p = self.covariance
        mean, half = (p[0, 0] + p[1, 1]) / 2, math.hypot((p[0, 0] - p[1, 1]) / 2, p[0, 1])
        return math.sqrt(max(0.0, mean + half))

    def motion(self) -> Motion:
        """The estimate as the controller takes it."""
        turn = rotation_from_attitude(self.state[6:10])
        yaw_rad = math.atan2(turn[1, 0], turn[0, 0])
        return Motion(self.state[:3].copy(), self.state[3:6].copy(), turn, self._rate, yaw_rad)

    def propagate(self, readings: Float64) -> bool:
        """Integrate IMU readings (samples, 6); false, and nothing done, if one is no number."""
        if not np.isfinite(readings).all():
            return False
        period_s = 1.0 / self._settings.imu.rate_hz
        self._rate = readings[-1, 3:] - self.state[10:13]
        _propagate(self.state, self.covariance, readings, period_s, self._noise)
        return True

    def see_bottom(self, velocities_m_s: Float64) -> int:
        """Correct by beam velocities (4,); those that are no number are left out.

        Returns:
            How many were used.
        """
        variance = self._settings.dvl.noise_m_s**2
        return _see_bottom(
            self.state, self.covariance, velocities_m_s, self._beams, self._arm, self._rate,
            variance,
        )  # fmt: skip

    def see_depth(self, z_m: float) -> None:
        """Correct by a height."""
        if math.isfinite(z_m):
            _see_depth(self.state, self.covariance, z_m, self._settings.depth.noise_m**2)

    def see_heading(self, yaw_rad: float) -> None:
        """Correct by a heading."""
        if math.isfinite(yaw_rad):
            variance = math.radians(self._settings.compass.noise_deg) ** 2
            _see_heading(self.state, self.covariance, yaw_rad, variance)


@kernel
def _propagate(
    state: Float64, covariance: Float64, readings: Float64, period_s: float, noise: Float64
) -> None:
    """Integrate a batch of IMU readings; the covariance is moved once, by their means."""
    turn = np.empty((3, 3))
    sum_turn, sum_force, sum_rate = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    count = len(readings)
    for k in range(count):
        force = readings[k, :3] - state[13:16]
        rate = readings[k, 3:] - state[10:13]
        before = state[6:10].copy()
        _turn_by(state[6:10], rate * period_s)
        middle = before + state[6:10]
        middle /= math.sqrt((middle * middle).sum())
        rotation_into(middle, turn)
        acceleration = np.zeros(3)
        for i in range(3):
            for j in range(3):
                acceleration[i] += turn[i, j] * force[j]
        acceleration[2] -= GRAVITY_M_S2
        state[:3] += period_s * state[3:6] + 0.5 * period_s * period_s * acceleration
        state[3:6] += period_s * acceleration
        sum_turn += turn
        sum_force += force
        sum_rate += rate
    whole_s = count * period_s
    _move_covariance(
        covariance, sum_turn / count, sum_force / count, sum_rate / count, whole_s, noise
    )


@kernel
def _move_covariance(
    covariance: Float64, turn: Float64, force: Float64, rate: Float64, t: float, noise: Float64
) -> None:
    """P = F P F' + Q over a time t."""
    n = len(covariance)
    f = np.eye(n)
    skew = np.zeros((3, 3))
    skew[0, 1], skew[0, 2] = -force[2], force[1]
    skew[1, 0], skew[1, 2] = force[2], -force[0]
    skew[2, 0], skew[2, 1] = -force[1], force[0]
    for i in range(3):
        f[P + i, V + i] = t
        f[A + i, GB + i] = -t
        for j in range(3):
            push = 0.0
            for k in range(3):
                push -= turn[i, k] * skew[k, j]
            f[V + i, A + j] = push * t
            f[P + i, A + j] = 0.5 * push * t * t
            f[V + i, AB + j] = -turn[i, j] * t
            f[P + i, AB + j] = -0.5 * turn[i, j] * t * t
    f[A, A + 1], f[A, A + 2] = rate[2] * t, -rate[1] * t
    f[A + 1, A], f[A + 1, A + 2] = -rate[2] * t, rate[0] * t
    f[A + 2, A], f[A + 2, A + 1] = rate[1] * t, -rate[0] * t
    stay = math.exp(-t / noise[5])
    f[CD, CD] = stay
    covariance[:, :] = np.dot(np.dot(f, covariance), f.T.copy())
    for i in range(3):
        covariance[V + i, V + i] += noise[0] * t
        covariance[A + i, A + i] += noise[1] * t
        covariance[GB + i, GB + i] += noise[2] * t
        covariance[AB + i, AB + i] += noise[3] * t
    covariance[CD, CD] += noise[4] * (1.0 - stay * stay)


@kernel
def _correct(
    state: Float64, covariance: Float64, slope: Float64, surprise: float, variance: float
) -> None:
    """One scalar measurement: gain, correction of the state, smaller covariance."""
    n = len(covariance)
    reach = np.zeros(n)
    for i in range(n):
        for j in range(n):
            reach[i] += covariance[i, j] * slope[j]
    spread = variance
    for i in range(n):
        spread += slope[i] * reach[i]
    shift = reach * (surprise / spread)
    for i in range(n):
        for j in range(i + 1):
            value = covariance[i, j] - reach[i] * reach[j] / spread
            covariance[i, j] = value
            covariance[j, i] = value
    state[:6] += shift[:6]
    _turn_by(state[6:10], shift[A:GB])
    state[10:18] += shift[GB:]


@kernel
def _see_bottom(
    state: Float64, covariance: Float64, readings: Float64, beams: Float64, arm: Float64,
    rate: Float64, variance: float,
) -> int:  # fmt: skip
    """Beam velocity: u . (R' v + w x arm) (1 + scale)."""
    turn = np.empty((3, 3))
    seen = 0
    for k in range(len(readings)):
        if not math.isfinite(readings[k]):
            continue
        seen += 1
        rotation_into(state[6:10], turn)
        own = np.zeros(3)
        for i in range(3):
            for j in range(3):
                own[i] += turn[j, i] * state[3 + j]
        swing = cross(rate, arm)
        along = 0.0
        for i in range(3):
            along += beams[k, i] * (own[i] + swing[i])
        scale = 1.0 + state[17]
        slope = np.zeros(len(covariance))
        sideways = cross(beams[k], own)  # u' [own]x
        lever = cross(beams[k], arm)
        for i in range(3):
            for j in range(3):
                slope[V + i] += scale * turn[i, j] * beams[k, j]
            slope[A + i] = scale * sideways[i]
            slope[GB + i] = scale * lever[i]
        slope[DS] = along
        _correct(state, covariance, slope, readings[k] - scale * along, variance)
    return seen


@kernel
def _see_depth(state: Float64, covariance: Float64, z_m: float, variance: float) -> None:
    slope = np.zeros(len(covariance))
    slope[P + 2] = 1.0
    _correct(state, covariance, slope, z_m - state[2], variance)


@kernel
def _see_heading(state: Float64, covariance: Float64, yaw_rad: float, variance: float) -> None:
    """Heading of the body's forward axis, plus the compass's deviation."""
    turn = np.empty((3, 3))
    rotation_into(state[6:10], turn)
    flat = turn[0, 0] * turn[0, 0] + turn[1, 0] * turn[1, 0]
    slope = np.zeros(len(covariance))
    # a turn d about the body's axes moves the forward axis by R (d x e1) = R (0, d3, -d2)
    slope[A + 1] = -(turn[0, 0] * turn[1, 2] - turn[1, 0] * turn[0, 2]) / flat
    slope[A + 2] = (turn[0, 0] * turn[1, 1] - turn[1, 0] * turn[0, 1]) / flat
    slope[CD] = 1.0
    surprise = yaw_rad - math.atan2(turn[1, 0], turn[0, 0]) - state[16]
    surprise -= 2.0 * math.pi * math.floor((surprise + math.pi) / (2.0 * math.pi))
    _correct(state, covariance, slope, surprise, variance)


@kernel
def _turn_by(q: Float64, turn: Float64) -> None:
    """Turn an attitude by a rotation vector about the body's axes, in place."""
    angle = math.sqrt((turn * turn).sum())
    half = 0.5 if angle < 1e-12 else math.sin(angle / 2) / angle
    w, x, y, z = math.cos(angle / 2), turn[0] * half, turn[1] * half, turn[2] * half
    a, b, c, d = q[0], q[1], q[2], q[3]
    q[0] = a * w - b * x - c * y - d * z
    q[1] = a * x + b * w + c * z - d * y
    q[2] = a * y - b * z + c * w + d * x
    q[3] = a * z + b * y - c * x + d * w
    q /= math.sqrt((q * q).sum())
