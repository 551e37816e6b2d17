"""Which blocks of voxels a sonar's fan touches."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from insonify.frames import directions_from_angles
from insonify.jit import kernel
from insonify.types import FanGeometry, Float64, Int32


def blocks_in_fan(transform: Float64, geometry: FanGeometry, block_m: float) -> Int32:
    """Indices (N, 3) of all blocks that a fan at ``world_from_sonar`` touches, a few more too."""
    rim = _rim(geometry) @ transform[:3, :3].T
    rim = np.vstack([np.zeros(3), rim]) + transform[:3, 3]
    low = np.floor(rim.min(axis=0) / block_m).astype(np.int32)
    high = np.floor(rim.max(axis=0) / block_m).astype(np.int32)
    return _cull(
        low,
        high,
        transform,
        block_m,
        geometry.azimuth_fov_rad / 2,
        geometry.elevation_fov_rad / 2,
        geometry.range_min_m,
        geometry.range_max_m,
    )


@lru_cache(maxsize=8)
def _rim(geometry: FanGeometry) -> Float64:
    """Points (N, 3) in the sonar frame whose box, with the sonar, holds the whole fan."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-0.5, 0.5, 17) * geometry.azimuth_fov_rad,
        np.linspace(-0.5, 0.5, 17) * geometry.elevation_fov_rad,
    )
    # between two of the 17 x 17 directions the sphere bulges out by less than this
    bulge = 1.0 / math.cos(max(geometry.azimuth_fov_rad, geometry.elevation_fov_rad) / 32) ** 2
    directions = directions_from_angles(azimuth, elevation).reshape(-1, 3)
    return directions * (geometry.range_max_m * bulge)


@kernel
def _cull(
    low: Int32,
    high: Int32,
    transform: Float64,
    block_m: float,
    half_azimuth: float,
    half_elevation: float,
    range_min_m: float,
    range_max_m: float,
) -> Int32:
    """Those of a box of blocks that the fan's sides, cones and spheres do not rule out."""
    half = 0.5 * block_m
    radius = math.sqrt(3.0) * half
    sin_a, cos_a = math.sin(half_azimuth), math.cos(half_azimuth)
    tan_e = math.tan(half_elevation)
    # half extents of a block along the sonar's axes
    along_x = half * (abs(transform[0, 0]) + abs(transform[1, 0]) + abs(transform[2, 0]))
    along_y = half * (abs(transform[0, 1]) + abs(transform[1, 1]) + abs(transform[2, 1]))
    along_z = half * (abs(transform[0, 2]) + abs(transform[1, 2]) + abs(transform[2, 2]))
    size = high - low + 1
    found = np.empty((size[0] * size[1] * size[2], 3), np.int32)
    count = 0
    for ix in range(low[0], high[0] + 1):
        for iy in range(low[1], high[1] + 1):
            for iz in range(low[2], high[2] + 1):
                dx = (ix + 0.5) * block_m - transform[0, 3]
                dy = (iy + 0.5) * block_m - transform[1, 3]
                dz = (iz + 0.5) * block_m - transform[2, 3]
                x = transform[0, 0] * dx + transform[1, 0] * dy + transform[2, 0] * dz
                y = transform[0, 1] * dx + transform[1, 1] * dy + transform[2, 1] * dz
                z = transform[0, 2] * dx + transform[1, 2] * dy + transform[2, 2] * dz
                flat = math.sqrt(x * x + y * y)
                distance = math.sqrt(flat * flat + z * z)
                near = distance <= range_max_m + radius and distance >= range_min_m - radius
                ahead = (x + along_x) * sin_a >= (abs(y) - along_y) * cos_a
                level = (flat + radius) * tan_e >= abs(z) - along_z
                if near and ahead and level:
                    found[count, 0] = ix
                    found[count, 1] = iy
                    found[count, 2] = iz
                    count += 1
    return found[:count]
