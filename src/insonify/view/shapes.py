"""Shapes that the page draws: the edges of a fan, a unit cube, lines through poses."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib import colormaps
from PIL import Image

from insonify.frames import directions_from_angles
from insonify.report.fans import fan_pixels
from insonify.types import Array, FanGeometry, Float32, Float64, Ping, Pose

_ARC = 24

CUBE_CORNERS: Float32 = np.array(
    [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32
)
CUBE_FACES: Array = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], np.uint32
)  # fmt: skip
"""Two triangles a side, anticlockwise from outside."""


def fan_edges(geometry: FanGeometry) -> Float32:
    """The edges of the space that a sonar insonifies, (N, 2, 3) metres in the sonar's frame."""
    half_az, half_el = geometry.azimuth_fov_rad / 2, geometry.elevation_fov_rad / 2
    azimuths = np.linspace(-half_az, half_az, _ARC + 1)
    segments = []
    for elevation in (-half_el, half_el):
        arc = directions_from_angles(azimuths, np.full(_ARC + 1, elevation))
        for range_m in (geometry.range_min_m, geometry.range_max_m):
            segments += list(pairwise(range_m * arc))
        segments += [
            (geometry.range_min_m * arc[k], geometry.range_max_m * arc[k]) for k in (0, -1)
        ]
    for azimuth in (-half_az, half_az):
        elevations = np.linspace(-half_el, half_el, 7)
        arc = geometry.range_max_m * directions_from_angles(np.full(7, azimuth), elevations)
        segments += list(pairwise(arc))
    return np.array(segments, np.float32)


def fan_picture(ping: Ping, width: int) -> tuple[Array, tuple[float, float, float, float]]:
    """A ping in fan view as RGBA bytes (height, width, 4), the far end on top, silence clear.

    Returns:
        The picture, and its extent (left, right, near, far) in metres.
    """
    grey, extent = fan_pixels(ping, width)
    picture = np.array(colormaps["copper"](np.nan_to_num(grey), bytes=True))
    picture[..., 3] = np.where(np.isnan(grey), 0.0, 255.0 * np.clip(0.2 + 2.0 * grey, 0.0, 1.0))
    return picture[::-1], extent


def png_bytes(picture: Array) -> bytes:
    """A picture as PNG."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="png")
    return stream.getvalue()


def path_segments(poses: Sequence[Pose]) -> Float32:
    """The legs between poses, (N - 1, 2, 3) metres."""
    places = np.array([pose.position_m for pose in poses], np.float32).reshape(-1, 3)
    return np.stack([places[:-1], places[1:]], axis=1)


def pointers(poses: Sequence[Pose], length_m: float) -> Float32:
    """A short line from each pose in the direction of its yaw, (N, 2, 3) metres."""
    start = np.array([pose.position_m for pose in poses], np.float64).reshape(-1, 3)
    yaw = np.array([pose.yaw_rad for pose in poses])
    along = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    return np.stack([start, start + length_m * along], axis=1).astype(np.float32)


def overview(low_m: Float64, high_m: Float64) -> tuple[Float64, Float64]:
    """A camera that sees a box whole: its position, from the south and above, and what it faces."""
    middle = (low_m + high_m) / 2
    size = max(1.0, float(np.linalg.norm(high_m - low_m)))
    lift = math.radians(35.0)
    way = np.array([0.35, -math.cos(lift), math.sin(lift)])
    return middle + size * way, middle
