"""A sonar's fan in space: what lies in it, and which blocks of voxels it touches."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from insonify.frames import directions_from_angles
from insonify.jit import kernel
from insonify.types import Box, FanGeometry, Float64, Int32


def fan_vector(geometry: FanGeometry) -> Float64:
    """A fan's geometry as kernels take it: half azimuth, half elevation, least range, beam, bin."""
    return np.array(
        [
            geometry.azimuth_fov_rad / 2,
            geometry.elevation_fov_rad / 2,
            geometry.range_min_m,
            geometry.beam_rad,
            geometry.bin_m,
        ]
    )


@kernel
def in_fan(
    transform: Float64, fan: Float64, range_max_m: float, point: Float64
) -> tuple[float, float]:
    """Distance and azimuth of a point from the sonar; a negative distance if it is out of view.

    Args:
        transform: ``world_from_sonar``, (4, 4).
        fan: See `fan_vector`.
        range_max_m: Where the fan ends.
        point: (3,) world frame.
    """
    dx = point[0] - transform[0, 3]
    dy = point[1] - transform[1, 3]
    dz = point[2] - transform[2, 3]
    square = dx * dx + dy * dy + dz * dz
    if square > range_max_m * range_max_m or square < fan[2] * fan[2]:
        return -1.0, 0.0
    z = transform[0, 2] * dx + transform[1, 2] * dy + transform[2, 2] * dz
    sin_elevation = math.sin(fan[1])
    if z * z > square * sin_elevation * sin_elevation:
        return -1.0, 0.0
    x = transform[0, 0] * dx + transform[1, 0] * dy + transform[2, 0] * dz
    y = transform[0, 1] * dx + transform[1, 1] * dy + transform[2, 1] * dz
    azimuth = math.atan2(y, x)
    if abs(azimuth) > fan[0]:
        return -1.0, 0.0
    return math.sqrt(square), azimuth


def blocks_in_fan(
    transform: Float64,
    geometry: FanGeometry,
    block_m: float,
    within: tuple[Int32, Int32] | None = None,
) -> Int32:
    """Indices (N, 3) of all blocks that a fan at ``world_from_sonar`` touches, a few more too.

    Args:
        transform: ``world_from_sonar``, (4, 4).
        geometry: The fan's.
        block_m: Edge length of a block.
        within: Only those from a block to another (3,), both included.
    """
    low, high = block_span(fan_box(transform, geometry), block_m)
    if within is not None:
        low, high = np.maximum(low, within[0]), np.minimum(high, within[1])
        if (low > high).any():
            return np.empty((0, 3), np.int32)
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


def block_span(box: Box, block_m: float) -> tuple[Int32, Int32]:
    """The least and the largest index (3,) of the blocks that a box touches."""
    low = np.floor(np.array(box.low_m) / block_m).astype(np.int32)
    high = np.floor(np.array(box.high_m) / block_m).astype(np.int32)
    return low, high


def fan_box(transform: Float64, geometry: FanGeometry) -> Box:
    """A box that holds all of a fan at ``world_from_sonar``."""
    rim = _rim(geometry) @ transform[:3, :3].T
    rim = np.vstack([np.zeros(3), rim]) + transform[:3, 3]
    return Box.of(rim.min(axis=0), rim.max(axis=0))


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
