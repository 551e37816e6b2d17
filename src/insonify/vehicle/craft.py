"""A vehicle under way: dynamics, sensors, navigation, guidance and control in one loop."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from insonify.frames import (
    pose_from_attitude,
    rotation_from_attitude,
    std_from_covariance,
    wrapped,
)
from insonify.types import Float64, Pose, StopReason, estimated
from insonify.vehicle.autopilot.control import Controller, Motion
from insonify.vehicle.autopilot.estimator import Estimator
from insonify.vehicle.autopilot.guidance import Follower
from insonify.vehicle.description import VehicleDescription
from insonify.vehicle.instruments import Clock, RayQuery
from insonify.vehicle.model import hydro
from insonify.vehicle.plant.currents import Current
from insonify.vehicle.plant.dynamics import advance, resting_state
from insonify.vehicle.plant.sensors import Compass, Depth, Dvl, Imu
from insonify.vehicle.settings import VehicleSettings

CONTROL_S = 0.05
"""The control's period; everything but the IMU samples on it."""
_LOG_HZ = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """Where the vehicle was, believed to be and was meant to be at a time.

    ``covariance`` is (6, 6): position in the world, attitude in the body frame; None under perfect
    navigation.
    """

    time_s: float
    true: Pose
    estimated: Pose
    planned: Pose
    covariance: Float64 | None


@dataclass(frozen=True, slots=True, eq=False)
class ImuReading:
    """What the IMU measured in one period of the control: the times (N,) and readings (N, 6).

    A reading is specific force (m/s2) and turn rate (rad/s), body frame.
    """

    times_s: Float64
    values: Float64


@dataclass(frozen=True, slots=True, eq=False)
class DvlReading:
    """What the Doppler log measured: velocities along its beams (4,) m/s, ranges (4,) m."""

    time_s: float
    velocities_m_s: Float64
    ranges_m: Float64


@dataclass(slots=True, eq=False)
class Track:
    """What a vehicle leaves behind.

    Attributes:
        moments: Four a second.
        readings: What its IMU and Doppler log measured since this was last emptied; none under
            perfect navigation.
        length_m: How far it flew.
    """

    moments: list[Moment] = field(default_factory=list)
    readings: list[ImuReading | DvlReading] = field(default_factory=list)
    length_m: float = 0.0


def pose_errors(track: Track) -> dict[str, float]:
    """Errors of the estimate: position (m) and heading (degrees), mean, largest, at last."""
    moments = track.moments
    away = [math.dist(m.true.position_m, m.estimated.position_m) for m in moments] or [0.0]
    turned = [
        abs(math.degrees(wrapped(m.true.yaw_rad - m.estimated.yaw_rad))) for m in moments
    ] or [0.0]
    return {
        "position_mean_m": round(float(np.mean(away)), 6),
        "position_max_m": round(max(away), 6),
        "position_last_m": round(away[-1], 6),
        "heading_mean_deg": round(float(np.mean(turned)), 6),
        "heading_max_deg": round(max(turned), 6),
    }


class Craft:
    """A vehicle in the water; each `tick` is one period of its control."""

    def __init__(
        self,
        vehicle: VehicleDescription,
        settings: VehicleSettings,
        start: Pose,
        look: RayQuery,
        rng: np.random.Generator,
    ) -> None:
        """At rest at a known start.

        Args:
            vehicle: What it is.
            settings: How it is flown and what it senses.
            start: Its pose, known to it.
            look: How the Doppler log's rays meet the world.
            rng: All its randomness: current and sensors.
        """
        self.vehicle, self.settings = vehicle, settings
        self.time_s = 0.0
        self.track = Track()
        self.lost: StopReason | None = None
        streams = iter(rng.spawn(5))
        sensors = settings.sensors
        self._model = hydro(vehicle, settings.density_kg_m3)
        self._state = resting_state(vehicle, start)
        self._current = Current(settings.current, next(streams))
        self._imu = Imu(sensors.imu, next(streams))
        self._dvl = Dvl(sensors.dvl, next(streams))
        self._depth = Depth(sensors.depth, next(streams))
        self._compass = Compass(sensors.compass, next(streams))
        self._dvl_clock = Clock(sensors.dvl.rate_hz)
        self._depth_clock = Clock(sensors.depth.rate_hz)
        self._compass_clock = Clock(sensors.compass.rate_hz)
        self._log_clock = Clock(_LOG_HZ)
        self._look = look
        self._steps = round(CONTROL_S * sensors.imu.rate_hz)
        filtered = settings.navigation == "dvl"
        self.estimator = Estimator(sensors, start) if filtered else None
        self._controller = Controller(vehicle, settings.control, settings.density_kg_m3)
        self.follower = Follower(settings.guidance, start)
        self._log()

    @property
    def true_pose(self) -> Pose:
        """Where it is."""
        return pose_from_attitude(self._state[:3], self._state[3:7])

    @property
    def true_state(self) -> Float64:
        """Where it is and how it moves: a copy of the state of `dynamics`."""
        return self._state.copy()

    @property
    def true_velocity(self) -> Float64:
        """How it moves over ground, (3,) m/s, world frame."""
        velocity: Float64 = rotation_from_attitude(self._state[3:7]) @ self._state[7:10]
        return velocity

    @property
    def believed_pose(self) -> Pose:
        """Where it believes it is."""
        return self.true_pose if self.estimator is None else self.estimator.pose

    @property
    def estimated_pose(self) -> Pose:
        """The believed pose with how far it may be off; without under perfect navigation."""
        if self.covariance is None:
            return self.believed_pose
        return estimated(self.believed_pose, std_from_covariance(self.covariance))

    @property
    def covariance(self) -> Float64 | None:
        """Of the believed pose, (6, 6) as in `Moment`; None under perfect navigation."""
        if self.estimator is None:
            return None
        pose_states = [0, 1, 2, 6, 7, 8]
        return self.estimator.covariance[np.ix_(pose_states, pose_states)]

    def motion(self) -> Motion:
        """How it believes to move."""
        if self.estimator is not None:
            return self.estimator.motion()
        turn = rotation_from_attitude(self._state[3:7])
        yaw_rad = float(np.arctan2(turn[1, 0], turn[0, 0]))
        velocity = turn @ self._state[7:10]
        return Motion(self._state[:3].copy(), velocity, turn, self._state[10:13].copy(), yaw_rad)

    def tick(self) -> None:
        """Steer, move and measure for one period."""
        motion = self.motion()
        goal = self.follower.step(motion.position_m, CONTROL_S)
        thrusts = self._controller.thrusts(motion, goal, CONTROL_S)
        before = self._state[:3].copy()
        water = self._current.over(CONTROL_S)
        period_s = CONTROL_S / self._steps
        trace = advance(self._state, thrusts, self._steps, period_s, self._model, water)
        self.time_s = round(self.time_s + CONTROL_S, 9)
        self.track.length_m += float(np.linalg.norm(self._state[:3] - before))
        if self.estimator is not None:
            self._navigate(self.estimator, trace)
        if self._log_clock.due(self.time_s):
            self._log()

    def failed(self, sensor: str) -> bool:
        """Whether a sensor has failed by now."""
        fault = self.settings.fault
        return fault.sensor == sensor and self.time_s >= fault.at_s

    def _navigate(self, estimator: Estimator, trace: Float64) -> None:
        """Measure what there is to measure, and tell the filter."""
        readings = self._imu.sample(trace[:, 13:19])
        if self.failed("imu"):
            readings[:] = np.nan
        count = len(readings)
        times_s = self.time_s - CONTROL_S * np.arange(count - 1, -1, -1) / count
        self.track.readings.append(ImuReading(times_s, readings))
        if not estimator.propagate(readings):
            self.lost = StopReason.IMU_FAILED
            return
        if self._dvl_clock.due(self.time_s):
            estimator.see_bottom(self._bottom_track())
        if self._depth_clock.due(self.time_s):
            estimator.see_depth(self._depth.sample(float(self._state[2])))
        if self._compass_clock.due(self.time_s):
            estimator.see_heading(self._compass.sample(self.true_pose.yaw_rad))
        if estimator.position_sigma_m > self.settings.lost_m:
            self.lost = StopReason.LOST

    def _bottom_track(self) -> Float64:
        state = self._state
        turn = rotation_from_attitude(state[3:7])
        readings = self._dvl.sample(state[:3], turn, state[7:10], state[10:13], self._look)
        ranges_m = self._dvl.ranges_m
        if self.failed("dvl"):
            readings[:] = np.nan
            ranges_m = np.full(4, np.nan)
        self.track.readings.append(DvlReading(self.time_s, readings, ranges_m))
        return readings

    def _log(self) -> None:
        goal = self.follower.set_point
        x, y, z = (float(c) for c in goal.position_m)
        self.track.moments.append(
            Moment(
                self.time_s,
                self.true_pose,
                self.believed_pose,
                Pose(x, y, z, yaw_rad=goal.yaw_rad),
                self.covariance,
            )
        )
