"""Rigid transforms and angles: the only place that builds rotations.

World ENU, body and sonar forward-left-up (REP 103).  Azimuth is positive to the left, elevation
positive up.  A sonar tilted down is pitched about the body's left axis.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from insonify.errors import GeometryError
from insonify.types import Float64, Pose, Trajectory


def rotation_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Float64:
    """Rotation matrix ``Rz(yaw) Ry(pitch) Rx(roll)``, (3, 3)."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def transform_from_pose(pose: Pose) -> Float64:
    """``world_from_body``, (4, 4), metres."""
    transform = np.eye(4)
    transform[:3, :3] = rotation_from_rpy(pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
    transform[:3, 3] = pose.position_m
    return transform


def pose_from_transform(transform: Float64) -> Pose:
    """The pose of ``world_from_body``, (4, 4); at a pitch of +-90 degrees the roll is 0."""
    r = transform[:3, :3]
    pitch_rad = math.asin(min(1.0, max(-1.0, -float(r[2, 0]))))
    if abs(r[2, 0]) < 1.0 - 1e-12:
        roll_rad, yaw_rad = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    else:
        roll_rad, yaw_rad = 0.0, math.atan2(-r[0, 1], r[1, 1])
    x_m, y_m, z_m = (float(c) for c in transform[:3, 3])
    return Pose(x_m, y_m, z_m, roll_rad, pitch_rad, yaw_rad)


def compose(outer: Pose, inner: Pose) -> Pose:
    """A pose given in the frame of ``outer``, in the frame that ``outer`` is given in."""
    return pose_from_transform(transform_from_pose(outer) @ transform_from_pose(inner))


def std_from_covariance(covariance: Float64) -> tuple[float, float]:
    """Standard deviations of position (m) and attitude (rad), each in its worst direction.

    Args:
        covariance: (6, 6), position first.

    Returns:
        0 for what it does not tell: ROS messages leave it 0, or say -1, where nothing is known.
    """
    if not np.isfinite(covariance).all() or covariance[0, 0] < 0.0:
        return 0.0, 0.0
    position, attitude = (
        math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance[part, part])[-1])))
        for part in (slice(0, 3), slice(3, 6))
    )
    return position, attitude


FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0, 1.0])
"""Forward, left, up from forward, starboard, down; its own inverse."""
ENU_FROM_NED = np.array(
    [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""East, north, up from north, east, down; its own inverse."""


def enu_from_ned(pose: Pose) -> Pose:
    """A pose given in north, east, down of a body with axes forward, starboard, down, in ours."""
    return pose_from_transform(ENU_FROM_NED @ transform_from_pose(pose) @ FLU_FROM_FRD)


def world_from_sonar(pose: Pose, mount: Pose) -> Float64:
    """``world_from_body @ body_from_sonar``, (4, 4), of a sonar mounted on a body."""
    return transform_from_pose(pose) @ transform_from_pose(mount)


def pose_from_quaternion(
    position_m: Sequence[float] | Float64, xyzw: Sequence[float] | Float64
) -> Pose:
    """A pose from a position and a quaternion, which need not be of unit length.

    Raises:
        GeometryError: A number is not finite, or the quaternion is zero.
    """
    quaternion = np.asarray(xyzw, np.float64)
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(quaternion).all() and length > 1e-9):
        raise GeometryError(f"{tuple(xyzw)} is no quaternion: check the order and the columns")
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_quat(quaternion / length).as_matrix()
    transform[:3, 3] = position_m
    return pose_from_transform(transform)


def pose_at(trajectory: Trajectory, time_s: float) -> Pose:
    """The pose at a time: positions straight, rotations by the shortest turn between two poses.

    Before the first and after the last time the body rests where it is then.
    """
    times_s, poses = trajectory.times_s, trajectory.poses
    after = bisect_right(times_s, time_s)
    if after == 0:
        return poses[0]
    if after == len(times_s) or time_s == times_s[after - 1]:
        return poses[after - 1]
    first, second = poses[after - 1], poses[after]
    part = (time_s - times_s[after - 1]) / (times_s[after] - times_s[after - 1])
    start, end = transform_from_pose(first), transform_from_pose(second)
    before, behind = (quaternion_from_rotation(pose[:3, :3]) for pose in (start, end))
    position_m = (1.0 - part) * start[:3, 3] + part * end[:3, 3]
    return pose_from_quaternion(position_m, slerp(before, behind, part))


def directions_from_angles(azimuth_rad: Float64, elevation_rad: Float64) -> Float64:
    """Unit vectors in the sonar frame, (..., 3), for azimuths and elevations of equal shape."""
    flat = np.cos(elevation_rad)
    return np.stack(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)], axis=-1
    )


def attitude_from_pose(pose: Pose) -> Float64:
    """A pose's attitude as a unit quaternion ``world_from_body``, (4,), scalar first."""
    cr, sr = math.cos(pose.roll_rad / 2), math.sin(pose.roll_rad / 2)
    cp, sp = math.cos(pose.pitch_rad / 2), math.sin(pose.pitch_rad / 2)
    cy, sy = math.cos(pose.yaw_rad / 2), math.sin(pose.yaw_rad / 2)
    return np.array(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


def rotation_from_attitude(attitude: Float64) -> Float64:
    """Rotation matrix (3, 3) of a unit quaternion, scalar first."""
    w, x, y, z = attitude
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_from_attitude(position_m: Float64, attitude: Float64) -> Pose:
    """The pose of a position (3,) and an attitude ``world_from_body``, scalar first."""
    w, x, y, z = (float(c) for c in attitude)
    pitch_rad = math.asin(min(1.0, max(-1.0, 2 * (w * y - x * z))))
    roll_rad = math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    yaw_rad = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    east, north, up = (float(c) for c in position_m)
    return Pose(east, north, up, roll_rad, pitch_rad, yaw_rad)


def wrapped(angle_rad: float) -> float:
    """The same angle within half a turn of zero."""
    return math.remainder(angle_rad, math.tau)


def quaternion_from_rotation(rotation: Float64) -> Float64:
    """Unit quaternion (x, y, z, w), (4,), of a rotation matrix, with w not negative."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True), np.float64)


def rotation_from_quaternion(quaternion: Float64) -> Float64:
    """Rotation matrix, (3, 3), of a quaternion (x, y, z, w) of any length but 0."""
    return np.asarray(Rotation.from_quat(quaternion).as_matrix(), np.float64)


def slerp(start: Float64, end: Float64, share: float) -> Float64:
    """The quaternion at ``share`` (0 to 1) of the shorter turn between two unit quaternions."""
    cosine = float(start @ end)
    if cosine < 0.0:  # the same rotation, the other way round
        end, cosine = -end, -cosine
    angle = math.acos(min(1.0, cosine))
    if angle < 1e-9:
        return start
    blend: Float64 = math.sin((1.0 - share) * angle) * start + math.sin(share * angle) * end
    return blend / math.sin(angle)
