"""Rigid transforms and angles: the only place that builds rotations.

World ENU, body and sonar forward-left-up (REP 103).  Azimuth is positive to the left, elevation
positive up.  A sonar tilted down by ``tilt_rad`` is pitched about the body's left axis.
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


def world_from_sonar(pose: Pose, tilt_rad: float) -> Float64:
    """Pose of a sonar mounted at the body's origin and tilted down by ``tilt_rad``, (4, 4)."""
    transform = transform_from_pose(pose)
    transform[:3, :3] = transform[:3, :3] @ rotation_from_rpy(0.0, tilt_rad, 0.0)
    return transform


def directions_from_angles(azimuth_rad: Float64, elevation_rad: Float64) -> Float64:
    """Unit vectors in the sonar frame, (..., 3), for azimuths and elevations of equal shape."""
    flat = np.cos(elevation_rad)
    return np.stack(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)], axis=-1
    )
