"""What a pose would see: entropy summed along each beam up to the first occupied voxel.

Park et al. 2025, eq. 6: ``H_sum = sum over beams b, sum over m in M_b of H(m)``, with
``M_b = {m : d(m) < d_occupied(b)}``.  As in the map update, a beam is a column of the image: the
whole elevation arc, ended by the nearest occupied voxel anywhere in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from insonify.frames import world_from_sonar
from insonify.jit import kernel, parallel_kernel, prange
from insonify.types import FanGeometry, Float32, Float64, Pose


def entropy_in_view(
    poses: Sequence[Pose],
    geometry: FanGeometry,
    voxel_m: float,
    occupied_m: Float64,
    voxels_m: Float64,
    entropy: Float32,
) -> Float64:
    """H_sum of each pose (eq. 6); every voxel counts once, in the beam that holds its centre.

    Args:
        poses: Vehicle poses.
        geometry: The sonar.
        voxel_m: Edge length of a voxel.
        occupied_m: (M, 3) centres of occupied voxels, world frame.
        voxels_m: (N, 3) centres of the voxels whose entropy counts.
        entropy: (N,) their entropy.

    Returns:
        (poses,) bits.
    """
    if not poses:
        return np.empty(0)
    transforms = np.stack([world_from_sonar(pose, geometry.mount) for pose in poses])
    return _sum_entropy(
        transforms,
        geometry.azimuth_fov_rad / 2,
        math.sin(geometry.elevation_fov_rad / 2),
        geometry.range_min_m,
        geometry.range_max_m,
        geometry.beams,
        0.5 * voxel_m,
        np.ascontiguousarray(occupied_m, np.float64),
        np.ascontiguousarray(voxels_m, np.float64),
        np.ascontiguousarray(entropy, np.float32),
    )


@kernel
def _in_fan(
    transform: Float64,
    point: Float64,
    half_azimuth: float,
    sin_elevation: float,
    range_min_m: float,
    range_max_m: float,
) -> tuple[float, float]:
    """Distance and azimuth of a point from the sonar; a negative distance if it is out of view."""
    dx = point[0] - transform[0, 3]
    dy = point[1] - transform[1, 3]
    dz = point[2] - transform[2, 3]
    square = dx * dx + dy * dy + dz * dz
    if square > range_max_m * range_max_m or square < range_min_m * range_min_m:
        return -1.0, 0.0
    z = transform[0, 2] * dx + transform[1, 2] * dy + transform[2, 2] * dz
    if z * z > square * sin_elevation * sin_elevation:
        return -1.0, 0.0
    x = transform[0, 0] * dx + transform[1, 0] * dy + transform[2, 0] * dz
    y = transform[0, 1] * dx + transform[1, 1] * dy + transform[2, 1] * dz
    azimuth = math.atan2(y, x)
    if abs(azimuth) > half_azimuth:
        return -1.0, 0.0
    return math.sqrt(square), azimuth


@parallel_kernel
def _sum_entropy(
    transforms: Float64,
    half_azimuth: float,
    sin_elevation: float,
    range_min_m: float,
    range_max_m: float,
    beams: int,
    half_voxel_m: float,
    occupied_m: Float64,
    voxels_m: Float64,
    entropy: Float32,
) -> Float64:
    sums = np.zeros(len(transforms))
    beam_rad = 2.0 * half_azimuth / beams
    for pose in prange(len(transforms)):
        transform = transforms[pose]
        nearest = np.full(beams, np.inf)
        for i in range(len(occupied_m)):
            distance, azimuth = _in_fan(
                transform, occupied_m[i], half_azimuth, sin_elevation, range_min_m, range_max_m
            )
            if distance > 0.0:
                spread = half_voxel_m / distance
                first = math.floor((half_azimuth - azimuth - spread) / beam_rad)
                last = math.floor((half_azimuth - azimuth + spread) / beam_rad)
                for beam in range(max(first, 0), min(last, beams - 1) + 1):
                    nearest[beam] = min(nearest[beam], distance)
        total = 0.0
        for i in range(len(voxels_m)):
            distance, azimuth = _in_fan(
                transform, voxels_m[i], half_azimuth, sin_elevation, range_min_m, range_max_m
            )
            if distance >= 0.0:
                beam = min(int((half_azimuth - azimuth) / beam_rad), beams - 1)
                if distance < nearest[beam]:
                    total += entropy[i]
        sums[pose] = total
    return sums
