"""A scene seen along rays from one pose: the grid of patches, casts, and what a hit echoes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from insonify.frames import directions_from_angles
from insonify.jit import parallel_kernel, prange
from insonify.scene import Scene
from insonify.scene.rays import Hits
from insonify.sonar.histogram import BEYOND, LEAST_FACING, Response, Samples, beam_loss
from insonify.types import FanGeometry, Float32, Float64, Int32, Int64


@dataclass(frozen=True, slots=True)
class View:
    """A scene seen by one or more pings of a fan; rays and normals are in the sonar's frame.

    Args:
        scene: What is there.
        geometry: The fan; the beams of the second ping follow those of the first.
        transforms: (pings, 4, 4), each from the sonar to the world.
        response: How surfaces echo.
    """

    scene: Scene
    geometry: FanGeometry
    transforms: Float64
    response: Response

    @property
    def beams(self) -> int:
        """Of all pings."""
        return len(self.transforms) * self.geometry.beams

    @property
    def transform(self) -> Float64:
        """Of the only ping."""
        (alone,) = self.transforms
        return alone  # type: ignore[no-any-return]

    def cast(self, directions: Float32, ping: Int32) -> tuple[Hits, Float32]:
        """First hits within range, and the normals that shade them.

        Args:
            directions: (N, 3), sonar frame.
            ping: (N,) which ping's they are.
        """
        turns = self.transforms[:, :3, :3].astype(np.float32)
        world = turned(directions, turns, ping)
        places = self.transforms[:, :3, 3]
        origin = places[0] if len(places) == 1 else places[ping]
        hits = self.scene.cast(origin, world, BEYOND * self.geometry.range_max_m)
        shading = self.scene.shading_normals(hits, world)
        back = np.ascontiguousarray(turns.transpose(0, 2, 1))
        normal = turned(hits.normal, back, ping)
        shading = normal if shading is hits.normal else turned(shading, back, ping)
        return Hits(hits.range_m, normal, hits.body, hits.triangle, hits.uv), shading

    def samples(
        self,
        offsets: Int64,
        directions: Float32,
        hits: Hits,
        shading: Float32,
        weight: Float32,
        step_az: float,
        step_el: float,
    ) -> Samples:
        """Hits as samples that echo."""
        rise_m, skew_m, echo, kept = _shade(
            hits.range_m, hits.normal, shading, hits.body, directions, weight,
            self.response.strengths(self.scene), step_az, step_el,
            self.response.vector(self.geometry),
        )  # fmt: skip
        return Samples(
            offsets.astype(np.int64), directions, hits.range_m, rise_m, skew_m, echo, kept,
            hits.body,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Even patches, beam-major, then azimuth, then elevation.

    Attributes:
        directions: (columns x rows, 3) float32 middles of the patches, sonar frame.
        azimuth: (columns,) from port to starboard.
        elevation: (rows,) upwards.
        step_az: Azimuth extent of a patch.
        step_el: Elevation extent of a patch.
    """

    directions: Float32
    azimuth: Float64
    elevation: Float64
    step_az: float
    step_el: float

    @property
    def columns(self) -> int:
        """Patches over all beams."""
        return len(self.azimuth)

    @property
    def rows(self) -> int:
        """Patches over the elevation."""
        return len(self.elevation)


def even_grid(geometry: FanGeometry, across_beam: int, over_elevation: int) -> Grid:
    """The even patches of a fan, so many across each beam and over its elevation."""
    columns = geometry.beams * across_beam
    return _grid(geometry.azimuth_fov_rad, geometry.elevation_fov_rad, columns, over_elevation)


@lru_cache(maxsize=8)
def _grid(azimuth_fov_rad: float, elevation_fov_rad: float, columns: int, rows: int) -> Grid:
    """One grid for all mounts of a fan: the heads of a scanning sonar have hundreds."""
    step_az, step_el = azimuth_fov_rad / columns, elevation_fov_rad / rows
    azimuth = azimuth_fov_rad / 2 - (np.arange(columns, dtype=np.float64) + 0.5) * step_az
    elevation = (np.arange(rows, dtype=np.float64) + 0.5) * step_el - elevation_fov_rad / 2
    mesh = np.meshgrid(azimuth, elevation, indexing="ij")
    directions = directions_from_angles(mesh[0], mesh[1]).reshape(-1, 3).astype(np.float32)
    return Grid(directions, azimuth, elevation, step_az, step_el)


@parallel_kernel
def turned(vectors: Float32, turns: Float32, which: Int32) -> Float32:
    """Vectors (N, 3), each by one of the turns (M, 3, 3); thin products of matrices are slow."""
    found = np.empty_like(vectors)
    for k in prange(len(vectors)):
        turn = turns[which[k]]
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        for i in range(3):
            found[k, i] = turn[i, 0] * x + turn[i, 1] * y + turn[i, 2] * z
    return found


@parallel_kernel
def _shade(
    range_m: Float32,
    normal: Float32,
    shading: Float32,
    body: Int32,
    directions: Float32,
    weight: Float32,
    strengths: Float32,
    step_az: float,
    step_el: float,
    response: Float32,
) -> tuple[Float32, Float32, Float32, Float32]:
    """Range extents, echo and weight of each sample."""
    count = len(range_m)
    rise_m = np.zeros(count, np.float32)
    skew_m = np.zeros(count, np.float32)
    echo = np.zeros(count, np.float32)
    kept = np.zeros(count, np.float32)
    for k in prange(count):
        if body[k] < 0 or weight[k] <= 0.0:
            continue
        n, s, d = normal[k], shading[k], directions[k]
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length == 0.0:
            continue
        flat = math.sqrt(d[0] * d[0] + d[1] * d[1])
        facing = abs(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / length
        upward = abs(n[2] * flat - d[2] * (n[0] * d[0] + n[1] * d[1]) / flat) / length
        across = abs(n[1] * d[0] - n[0] * d[1]) / length  # cos(elevation) is in it
        per_rad = range_m[k] / max(facing, LEAST_FACING)
        rise_m[k] = per_rad * upward * step_el
        skew_m[k] = per_rad * across * step_az
        cosine = abs(s[0] * d[0] + s[1] * d[1] + s[2] * d[2])
        cosine /= math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        if response[0] > 0.0:
            strength = strengths[body[k]] * cosine * flat
        else:
            intensity = min(1.0, cosine * strengths[body[k]])
            strength = 1.0 / (1.0 + math.exp(-response[1] * (intensity - response[2])))
        echo[k] = strength * beam_loss(math.asin(d[2]), response[3])
        kept[k] = weight[k]
    return rise_m, skew_m, echo, kept
