"""What a pose would see of a map: in each beam, all up to the first occupied voxel."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from insonify.frames import world_from_sonar
from insonify.jit import kernel, parallel_kernel, prange
from insonify.mapping.fan import fan_box, fan_vector, in_fan
from insonify.mapping.voxels import VoxelMap
from insonify.types import Box, FanGeometry, Float32, Float64, Pose


def before_the_first_occupied(
    voxels: VoxelMap, poses: Sequence[Pose], geometry: FanGeometry, voxels_m: Float64
) -> Float32:
    """Which voxels lie before the first occupied one of their beam.

    ``M_b = {m : d(m) < d_occupied(b)}`` of Park et al. 2025, eq. 6.  As in the map update, a beam
    is a column of the image: the whole elevation arc, ended by the nearest occupied voxel anywhere
    in it.  A voxel belongs to the beam that holds its centre.

    Args:
        voxels: The map.
        poses: Vehicle poses.
        geometry: The sonar.
        voxels_m: (N, 3) centres of the voxels asked for, world frame.

    Returns:
        (poses, N), 1 or 0.
    """
    if not poses:
        return np.empty((0, len(voxels_m)), np.float32)
    transforms = np.stack([world_from_sonar(pose, geometry.mount) for pose in poses])
    boxes = [fan_box(transform, geometry) for transform in transforms]
    reach = Box.of(
        np.min([box.low_m for box in boxes], axis=0), np.max([box.high_m for box in boxes], axis=0)
    )
    return _in_sight(
        transforms,
        fan_vector(geometry),
        geometry.range_max_m,
        geometry.beams,
        0.5 * voxels.voxel_m,
        voxels.occupied_m(reach),
        np.ascontiguousarray(voxels_m, np.float64),
    )


@kernel
def _nearest_occupied(
    transform: Float64,
    fan: Float64,
    range_max_m: float,
    half_voxel_m: float,
    occupied_m: Float64,
    nearest: Float64,
) -> None:
    """Distance of the first occupied voxel of each beam, into ``nearest`` (beams,)."""
    beams = len(nearest)
    beam_rad = 2.0 * fan[0] / beams
    for i in range(len(occupied_m)):
        distance, azimuth = in_fan(transform, fan, range_max_m, occupied_m[i])
        if distance > 0.0:
            spread = half_voxel_m / distance
            first = math.floor((fan[0] - azimuth - spread) / beam_rad)
            last = math.floor((fan[0] - azimuth + spread) / beam_rad)
            for beam in range(max(first, 0), min(last, beams - 1) + 1):
                nearest[beam] = min(nearest[beam], distance)


@parallel_kernel
def _in_sight(
    transforms: Float64,
    fan: Float64,
    range_max_m: float,
    beams: int,
    half_voxel_m: float,
    occupied_m: Float64,
    voxels_m: Float64,
) -> Float32:
    seen = np.zeros((len(transforms), len(voxels_m)), np.float32)
    beam_rad = 2.0 * fan[0] / beams
    for pose in prange(len(transforms)):
        transform = transforms[pose]
        nearest = np.full(beams, np.inf)
        _nearest_occupied(transform, fan, range_max_m, half_voxel_m, occupied_m, nearest)
        for i in range(len(voxels_m)):
            distance, azimuth = in_fan(transform, fan, range_max_m, voxels_m[i])
            if distance >= 0.0:
                beam = min(int((fan[0] - azimuth) / beam_rad), beams - 1)
                if distance < nearest[beam]:
                    seen[pose, i] = 1.0
    return seen
