"""The CPU renderer: Embree rays.

Rays are cast on an even grid of patches first.  Where neighbouring patches do not lie on one
plane, at outlines, steps and creases in range, the patches are divided and cast again: samples go
where range bins need them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from insonify.frames import world_from_sonar
from insonify.jit import kernel, parallel_kernel, prange
from insonify.scene import Scene
from insonify.scene.rays import Hits
from insonify.sonar.histogram import (
    BEYOND,
    EchoHistogram,
    Response,
    Samples,
    gather,
    side_by_side,
)
from insonify.sonar.multipath import mirrored_samples
from insonify.sonar.patches import Grid, View, even_grid
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

    def render_all(
        self, scene: Scene, fans: Sequence[FanGeometry], poses: Sequence[Pose], response: Response
    ) -> EchoHistogram:
        """The echoes of several pings, their rays in one call."""
        samples = partial(self._samples, scene, fans[0], response=response)
        transforms = [world_from_sonar(p, fan.mount) for fan, p in zip(fans, poses, strict=True)]
        if response.indirect:
            return side_by_side([gather(samples(one[None]), fans[0]) for one in transforms])
        return gather(samples(np.stack(transforms)), fans[0], len(fans))

    def sample(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> list[Samples]:
        """The even samples, and those of divided patches."""
        transform = world_from_sonar(pose, geometry.mount)
        return self._samples(scene, geometry, transform[None], response)

    def _samples(
        self, scene: Scene, geometry: FanGeometry, transforms: Float64, response: Response
    ) -> list[Samples]:
        grid = even_grid(geometry, *even_samples(geometry, self.sampling))
        view, per_ping = View(scene, geometry, transforms, response), len(grid.directions)
        directions = np.tile(grid.directions, (len(transforms), 1))
        hits, shading = view.cast(
            directions, np.arange(len(directions), dtype=np.int32) // per_ping
        )
        whole = np.ones(len(directions), np.bool_)
        sets = []
        if self.sampling.refine > 1:
            rough = rough_patches(view, grid, directions, hits)
            whole = ~rough
            if rough.any():
                sets.append(self._divide(view, grid, rough))
        even = np.arange(view.beams + 1) * (per_ping // geometry.beams)
        weight = np.where(whole, np.float32(1.0 / (even[1])), np.float32(0.0))
        sets.append(
            view.samples(even, directions, hits, shading, weight, grid.step_az, grid.step_el)
        )
        if response.indirect:
            sets += mirrored_samples(view, grid, hits)
        return sets

    def _divide(self, view: View, grid: Grid, rough: Bool) -> Samples:
        """Samples of the rough patches, each divided ``refine`` times across and over."""
        parts = self.sampling.refine
        directions, starts, ping = divided_patches(view, grid, rough, parts)
        hits, shading = view.cast(directions, ping)
        per_beam = len(rough) // view.beams
        weight = np.full(len(directions), 1.0 / (per_beam * parts * parts), np.float32)
        return view.samples(
            starts, directions, hits, shading, weight, grid.step_az / parts, grid.step_el / parts
        )


def rough_patches(view: View, grid: Grid, directions: Float32, hits: Hits) -> Bool:
    """Which patches (N,) of the grids of all pings do not continue into their neighbours' planes.

    Args:
        view: The pings.
        grid: Of one.
        directions: (N, 3), of all.
        hits: Theirs.
    """
    geometry = view.geometry
    return _rough(
        hits.range_m, hits.normal, hits.body, directions, grid.columns, grid.rows,
        geometry.bin_m, BEYOND * geometry.range_max_m,
    )  # fmt: skip


def divided_patches(
    view: View, grid: Grid, rough: Bool, parts: int
) -> tuple[Float32, Int64, Int32]:
    """The parts of rough patches: directions, where each beam's begin, and whose ping they are."""
    chosen, square = np.flatnonzero(rough), parts * parts
    directions = _divided(chosen, grid.azimuth, grid.elevation, grid.step_az, grid.step_el, parts)
    starts = np.searchsorted(chosen, np.arange(view.beams + 1) * (len(rough) // view.beams))
    ping = np.repeat((chosen // len(grid.directions)).astype(np.int32), square)
    return directions, starts * square, ping


@parallel_kernel
def _divided(
    chosen: Int64,
    azimuth: Float64,
    elevation: Float64,
    step_az: float,
    step_el: float,
    parts: int,
) -> Float32:
    """Directions of the parts of chosen patches, counted through the grids of all pings."""
    columns, rows = len(azimuth), len(elevation)
    directions = np.empty((len(chosen) * parts * parts, 3), np.float32)
    for i in prange(len(chosen)):
        for a in range(parts):
            az = azimuth[chosen[i] // rows % columns] + ((a + 0.5) / parts - 0.5) * step_az
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
    """Patches that do not continue into all their neighbours' planes, of one or more grids."""
    rough = np.zeros(len(range_m), np.bool_)
    for column in prange(len(range_m) // rows):
        within = column % columns
        for row in range(rows):
            k = column * rows + row
            found = False
            if row > 0:
                found |= _apart(range_m, normal, body, directions, k - 1, k, tol_m, limit_m)
            if row < rows - 1:
                found |= _apart(range_m, normal, body, directions, k, k + 1, tol_m, limit_m)
            if within > 0:
                found |= _apart(range_m, normal, body, directions, k - rows, k, tol_m, limit_m)
            if within < columns - 1:
                found |= _apart(range_m, normal, body, directions, k, k + rows, tol_m, limit_m)
            rough[k] = found
    return rough
