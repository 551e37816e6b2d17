"""Rigid transforms and angles: the only place that builds rotations.

World ENU, body and sonar forward-left-up (REP 103).  Azimuth is positive to the left, elevation
positive up.  A sonar tilted down is pitched about the body's left axis.
"""

from __future__ import annotations

import math

import numpy as np

from insonify.types import Float64, Pose


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


def world_from_sonar(pose: Pose, mount: Pose) -> Float64:
    """``world_from_body @ body_from_sonar``, (4, 4), of a sonar mounted on a body."""
    return transform_from_pose(pose) @ transform_from_pose(mount)


def directions_from_angles(azimuth_rad: Float64, elevation_rad: Float64) -> Float64:
    """Unit vectors in the sonar frame, (..., 3), for azimuths and elevations of equal shape."""
    flat = np.cos(elevation_rad)
    return np.stack(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)], axis=-1
    )


def quaternion_from_rotation(rotation: Float64) -> Float64:
    """Unit quaternion (x, y, z, w), (4,), of a rotation matrix, with w not negative.

    The largest of the four is found first, so that no small number divides (Shepperd 1978).
    """
    r = rotation
    trace = float(np.trace(r))
    squares = np.array([*(1.0 + 2.0 * np.diag(r) - trace), 1.0 + trace]) / 4.0
    largest = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], (r[0, 1] + r[1, 0]) / 4, (r[0, 2] + r[2, 0]) / 4, (r[2, 1] - r[1, 2]) / 4],
            [(r[0, 1] + r[1, 0]) / 4, squares[1], (r[1, 2] + r[2, 1]) / 4, (r[0, 2] - r[2, 0]) / 4],
            [(r[0, 2] + r[2, 0]) / 4, (r[1, 2] + r[2, 1]) / 4, squares[2], (r[1, 0] - r[0, 1]) / 4],
            [(r[2, 1] - r[1, 2]) / 4, (r[0, 2] - r[2, 0]) / 4, (r[1, 0] - r[0, 1]) / 4, squares[3]],
        ]
    )[largest]
    quaternion: Float64 = products / np.linalg.norm(products)
    return -quaternion if quaternion[3] < 0.0 else quaternion


def rotation_from_quaternion(quaternion: Float64) -> Float64:
    """Rotation matrix, (3, 3), of a quaternion (x, y, z, w) of any length but 0."""
    x, y, z, w = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


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
