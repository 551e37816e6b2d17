"""Echoes of the water's surface seen from below, and by way of a mirror: it or a second surface.

A ray that meets a mirror goes on as the straight ray into the mirrored world does.  What it finds
there, B, is heard three times: out and back by the mirror, out by it and back straight, and the
other way round, where B is in plain view.  A surface mirrors what it does not let in, the share
``R^2 = pi mu`` of the sound's energy (`scene.materials`); the water's surface nearly all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from insonify.jit import kernel
from insonify.scene.rays import Hits
from insonify.sonar.histogram import BEYOND, Samples, beam_loss
from insonify.sonar.patches import Grid, View
from insonify.types import Array, Float32, Float64

_OFF_M = 1e-3
"""Rays leave a mirror from so far in front of it."""
_SURFACE_KEEPS = 0.9
"""Energy kept at the water's surface in a light sea; calm water keeps all but 0.001."""


def mirrored_samples(view: View, grid: Grid, hits: Hits) -> list[Samples]:
    """Samples of the water's surface, and of all that mirrors show.

    Args:
        view: The scene and the sonar's pose.
        grid: The patches.
        hits: Their first hits, normals in the sonar frame.
    """
    sets: list[Samples] = []
    turn = view.transform[:3, :3]
    world = (grid.directions @ turn.T).astype(np.float64)
    if view.response.second_bounce:
        met = np.flatnonzero(hits.body >= 0)
        normal = hits.normal[met].astype(np.float64) @ turn.T
        kept = np.minimum(math.pi * view.scene.lambert[hits.body[met]], 1.0)
        mirrors = _Mirrors(met, hits.range_m[met].astype(np.float64), _unit(normal), kept)
        sets += _seen_in(mirrors, view, grid, world)
    if view.response.surface_mirror or view.response.surface > 0.0:
        up_m = np.full(len(world), np.inf)
        rising = world[:, 2] > 1e-9
        up_m[rising] = -view.transform[2, 3] / world[rising, 2]
        met = np.flatnonzero((up_m > 0.0) & (up_m < hits.range_m) & np.isfinite(up_m))
        normal = np.tile([0.0, 0.0, 1.0], (len(met), 1))
        if view.response.surface > 0.0:
            sets.append(_surface(met, up_m[met], normal, view, grid))
        if view.response.surface_mirror:
            kept = np.full(len(met), _SURFACE_KEEPS)
            sets += _seen_in(_Mirrors(met, up_m[met], normal, kept), view, grid, world)
    return sets


def _surface(ray: Array, up_m: Float64, normal: Float64, view: View, grid: Grid) -> Samples:
    """Samples of the water's surface itself, where rays reach it within range."""
    near = up_m < BEYOND * view.geometry.range_max_m
    ray, nothing = ray[near], np.full(int(near.sum()), -1, np.int32)
    there = Hits(
        up_m[near].astype(np.float32),
        (normal[near] @ view.transform[:3, :3]).astype(np.float32),
        np.full(len(ray), len(view.scene.meshes), np.int32),
        nothing,
        np.zeros((len(ray), 2), np.float32),
    )
    per_beam = len(grid.directions) // view.geometry.beams
    weight = np.full(len(ray), 1.0 / per_beam, np.float32)
    return _samples(view, grid, grid.directions[ray], ray // per_beam, there, weight)


@dataclass(frozen=True, slots=True, eq=False)
class _Mirrors:
    """Where rays are mirrored: which rays, at what range, the unit normal, the energy kept."""

    ray: Array
    range_m: Float64
    normal: Float64
    kept: Float64


def _seen_in(mirrors: _Mirrors, view: View, grid: Grid, world: Float64) -> list[Samples]:
    limit_m = BEYOND * view.geometry.range_max_m
    direction, eye = world[mirrors.ray], view.transform[:3, 3]
    facing = np.einsum("ij,ij->i", direction, mirrors.normal)
    bent = direction - 2.0 * facing[:, None] * mirrors.normal
    point = eye + direction * mirrors.range_m[:, None]
    start = point - np.sign(facing)[:, None] * mirrors.normal * _OFF_M
    second = view.scene.cast(start, bent.astype(np.float32), limit_m)
    total_m = mirrors.range_m + second.range_m
    found = np.flatnonzero((second.body >= 0) & (total_m < 2.0 * limit_m))
    if not len(found):
        return []
    ray, bent, total_m = mirrors.ray[found], bent[found], total_m[found]
    kept, axis = mirrors.kept[found].astype(np.float32), mirrors.normal[found]
    normal = second.normal[found].astype(np.float64)
    virtual = normal - 2.0 * np.einsum("ij,ij->i", normal, axis)[:, None] * axis
    image = Hits(
        total_m.astype(np.float32),
        (virtual @ view.transform[:3, :3]).astype(np.float32),
        second.body[found],
        second.triangle[found],
        second.uv[found],
    )
    per_beam = len(world) // view.geometry.beams
    weight = np.full(len(ray), 1.0 / per_beam, np.float32)
    beam = ray // per_beam
    there = _samples(view, grid, grid.directions[ray], beam, image, weight)
    target = start[found] + bent * second.range_m[found, None]
    straight = target - eye
    direct_m = np.linalg.norm(straight, axis=1)
    plain = _in_plain_view(view, straight, direct_m)
    arrival = (straight / direct_m[:, None]) @ view.transform[:3, :3]
    seen_beam, inside = _beam_of(view, arrival)
    mixed_m = ((total_m + direct_m) / 2).astype(np.float32)
    louder = np.where(plain & inside, (mixed_m / direct_m) ** 2, 0.0).astype(np.float32) * kept
    pattern = float(view.response.vector(view.geometry)[3])
    louder *= _one_way(arrival[:, 2], grid.directions[ray, 2], pattern)
    half_way = Hits(mixed_m, image.normal, image.body, image.triangle, image.uv)
    mixed = _samples(view, grid, grid.directions[ray], beam, half_way, weight)
    return [
        _faded(there, kept * kept, beam, view),
        _faded(mixed, louder, beam, view),
        _faded(mixed, louder, seen_beam, view),
    ]


@kernel
def _one_way(upwards: Float64, instead_of: Float32, pattern: float) -> Float32:
    """What one way through the beam keeps at sines of elevations, over what it keeps at others."""
    found = np.empty(len(upwards), np.float32)
    for k in range(len(upwards)):
        here = beam_loss(math.asin(min(max(upwards[k], -1.0), 1.0)), pattern)
        there = beam_loss(math.asin(instead_of[k]), pattern)
        found[k] = math.sqrt(here / max(there, 1e-12))
    return found


def _samples(
    view: View, grid: Grid, directions: Float32, beam: Array, hits: Hits, weight: Float32
) -> Samples:
    offsets = np.searchsorted(beam, np.arange(view.geometry.beams + 1))
    return view.samples(offsets, directions, hits, hits.normal, weight, grid.step_az, grid.step_el)


def _faded(samples: Samples, kept: Float32, beam: Array, view: View) -> Samples:
    """Samples with a share of their echo, heard in given beams."""
    order = np.argsort(beam, kind="stable")
    return Samples(
        np.searchsorted(beam[order], np.arange(view.geometry.beams + 1)).astype(np.int64),
        samples.direction[order],
        samples.range_m[order],
        samples.rise_m[order],
        samples.skew_m[order],
        (samples.echo * kept)[order],
        samples.weight[order],
        samples.body[order],
    )


def _in_plain_view(view: View, straight: Float64, direct_m: Float64) -> Array:
    """Whether nothing stands between the sonar and points at vectors from it."""
    towards = (straight / direct_m[:, None]).astype(np.float32)
    first = view.scene.cast(view.transform[:3, 3], towards, float(direct_m.max()) + 1.0)
    return first.range_m > direct_m - np.maximum(0.01, 1e-3 * direct_m)


def _beam_of(view: View, arrival: Float64) -> tuple[Array, Array]:
    """The beam in which sound from a direction (N, 3), sonar frame, arrives; and whether any."""
    geometry = view.geometry
    azimuth = np.arctan2(arrival[:, 1], arrival[:, 0])
    elevation = np.arcsin(np.clip(arrival[:, 2], -1.0, 1.0))
    inside = np.abs(azimuth) <= geometry.azimuth_fov_rad / 2
    inside &= np.abs(elevation) <= geometry.elevation_fov_rad / 2
    beam = np.floor((geometry.azimuth_fov_rad / 2 - azimuth) / geometry.beam_rad).astype(np.int64)
    return np.clip(beam, 0, geometry.beams - 1), inside


def _unit(vectors: Float64) -> Float64:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Float64 = vectors / np.maximum(length, 1e-30)
    return unit
