"""The CPU renderer: Embree rays.

Rays are cast on an even grid of patches first.  Where neighbouring patches do not lie on one
plane, at outlines, steps and creases in range, the patches are divided and cast again: samples go
where range bins need them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from insonify.frames import directions_from_angles, world_from_sonar
from insonify.jit import kernel, parallel_kernel, prange
from insonify.scene import Scene
from insonify.scene.rays import Hits
from insonify.sonar.histogram import BEYOND, LEAST_FACING, EchoHistogram, Response, Samples, gather
from insonify.sonar.sampling import SamplingSettings, even_samples
from insonify.types import Bool, FanGeometry, Float32, Float64, Int32, Int64, Pose


@dataclass(frozen=True, slots=True)
class EmbreeRenderer:
    """Renders echo histograms with rays; `sonar.histogram.Renderer`.

    Args:
        sampling: How finely.
    """

    sampling: SamplingSettings = SamplingSettings()

    def render(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> EchoHistogram:
        """The echoes of a scene from a vehicle pose (Cerqueira et al. 2017, sections 3.2, 3.3).

        A sample's intensity is the cosine between surface normal and direction to the sonar,
        times the material's strength.  Either side of a triangle echoes alike.
        """
        return gather(self.sample(scene, geometry, pose, response), geometry)

    def sample(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> list[Samples]:
        """The even samples, and those of divided patches."""
        grid = _grid(geometry, *even_samples(geometry, self.sampling))
        transform = world_from_sonar(pose, geometry.mount)
        view = _View(scene, geometry, transform, response)
        hits, shading = view.cast(grid.directions)
        whole = np.ones(len(grid.directions), np.bool_)
        sets = []
        if self.sampling.refine > 1:
            rough = _rough(
                hits.range_m, hits.normal, hits.body, grid.directions, grid.columns, grid.rows,
                geometry.bin_m, BEYOND * geometry.range_max_m,
            )  # fmt: skip
            whole = ~rough
            if rough.any():
                sets.append(self._divide(view, grid, rough))
        even = np.arange(geometry.beams + 1) * (len(grid.directions) // geometry.beams)
        weight = np.where(whole, np.float32(1.0 / (even[1])), np.float32(0.0))
        sets.append(
            view.samples(even, grid.directions, hits, shading, weight, grid.step_az, grid.step_el)
        )
        return sets

    def _divide(self, view: _View, grid: _Grid, rough: Bool) -> Samples:
        """Samples of the rough patches, each divided ``refine`` times across and over."""
        parts = self.sampling.refine
        chosen = np.flatnonzero(rough)
        per_beam = len(rough) // view.geometry.beams
        directions = _divided(
            chosen, grid.azimuth, grid.elevation, grid.step_az, grid.step_el, parts
        )
        hits, shading = view.cast(directions)
        starts = np.searchsorted(chosen, np.arange(view.geometry.beams + 1) * per_beam)
        weight = np.full(len(directions), 1.0 / (per_beam * parts * parts), np.float32)
        return view.samples(
            starts * parts * parts, directions, hits, shading, weight,
            grid.step_az / parts, grid.step_el / parts,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _View:
    """A scene seen from one sonar pose; rays and normals are in the sonar frame."""

    scene: Scene
    geometry: FanGeometry
    transform: Float64
    response: Response

    def cast(self, directions: Float32) -> tuple[Hits, Float32]:
        """First hits within range, and the normals that shade them."""
        turn = self.transform[:3, :3].astype(np.float32)
        world = directions @ turn.T
        hits = self.scene.cast(self.transform[:3, 3], world, BEYOND * self.geometry.range_max_m)
        shading = self.scene.shading_normals(hits, world)
        return Hits(hits.range_m, hits.normal @ turn, hits.body, hits.triangle, hits.uv), (
            shading @ turn
        )

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
class _Grid:
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
        return len(self.azimuth)

    @property
    def rows(self) -> int:
        return len(self.elevation)


@lru_cache(maxsize=8)
def _grid(geometry: FanGeometry, across_beam: int, over_elevation: int) -> _Grid:
    columns = geometry.beams * across_beam
    step_az = geometry.azimuth_fov_rad / columns
    step_el = geometry.elevation_fov_rad / over_elevation
    azimuth = geometry.azimuth_fov_rad / 2 - (np.arange(columns, dtype=np.float64) + 0.5) * step_az
    elevation = (np.arange(over_elevation, dtype=np.float64) + 0.5) * step_el
    elevation -= geometry.elevation_fov_rad / 2
    mesh = np.meshgrid(azimuth, elevation, indexing="ij")
    directions = directions_from_angles(mesh[0], mesh[1]).reshape(-1, 3).astype(np.float32)
    return _Grid(directions, azimuth, elevation, step_az, step_el)


@parallel_kernel
def _divided(
    chosen: Int64,
    azimuth: Float64,
    elevation: Float64,
    step_az: float,
    step_el: float,
    parts: int,
) -> Float32:
    """Directions of the parts of chosen patches."""
    rows = len(elevation)
    directions = np.empty((len(chosen) * parts * parts, 3), np.float32)
    for i in prange(len(chosen)):
        for a in range(parts):
            az = azimuth[chosen[i] // rows] + ((a + 0.5) / parts - 0.5) * step_az
            for e in range(parts):
                el = elevation[chosen[i] % rows] + ((e + 0.5) / parts - 0.5) * step_el
                k = (i * parts + a) * parts + e
                directions[k, 0] = math.cos(el) * math.cos(az)
                directions[k, 1] = math.cos(el) * math.sin(az)
                directions[k, 2] = math.sin(el)
    return directions


@kernel
def _apart(
    range_m: Float32,
    normal: Float32,
    body: Int32,
    directions: Float32,
    i: int,
    j: int,
    tol_m: float,
    limit_m: float,
) -> bool:
    """Whether two neighbouring rays met surfaces that do not continue into each other.

    A surface that leaves the range between them does continue.
    """
    if body[i] < 0 and body[j] < 0:
        return False
    if body[i] < 0:
        i, j = j, i
    here = normal[i, 0] * directions[i, 0]
    here += normal[i, 1] * directions[i, 1] + normal[i, 2] * directions[i, 2]
    there = normal[i, 0] * directions[j, 0]
    there += normal[i, 1] * directions[j, 1] + normal[i, 2] * directions[j, 2]
    if body[j] < 0:
        return bool(here * there > 0.0 and range_m[i] * here / there < limit_m)
    if body[i] != body[j] or here * there <= 0.0:
        return True
    return bool(abs(range_m[i] * here / there - range_m[j]) > tol_m)


@parallel_kernel
def _rough(
    range_m: Float32,
    normal: Float32,
    body: Int32,
    directions: Float32,
    columns: int,
    rows: int,
    tol_m: float,
    limit_m: float,
) -> Bool:
    """Patches that do not continue into all their neighbours' planes."""
    rough = np.zeros(columns * rows, np.bool_)
    for column in prange(columns):
        for row in range(rows):
            k = column * rows + row
            found = False
            if row > 0:
                found |= _apart(range_m, normal, body, directions, k - 1, k, tol_m, limit_m)
            if row < rows - 1:
                found |= _apart(range_m, normal, body, directions, k, k + 1, tol_m, limit_m)
            if column > 0:
                found |= _apart(range_m, normal, body, directions, k - rows, k, tol_m, limit_m)
            if column < columns - 1:
                found |= _apart(range_m, normal, body, directions, k, k + rows, tol_m, limit_m)
            rough[k] = found
    return rough


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
        elevation = math.asin(d[2])
        echo[k] = strength * math.exp(-response[3] * elevation * elevation)
        kept[k] = weight[k]
    return rise_m, skew_m, echo, kept
