"""Ground truth of an image: what each pixel shows, and what it cannot show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.frames import world_from_sonar
from insonify.scene import Scene
from insonify.scene.rays import Hits
from insonify.sonar.embree import divided_patches, rough_patches
from insonify.sonar.histogram import BEYOND, Response, Samples, gather, strongest
from insonify.sonar.patches import View, even_grid, turned
from insonify.sonar.sampling import SamplingSettings, even_samples
from insonify.types import Bool, FanGeometry, Float32, Int32, Int64, Pose

_COLOURS = (
    "1f77b4", "ff7f0e", "2ca02c", "d62728", "9467bd", "8c564b", "e377c2", "7f7f7f", "bcbd22",
    "17becf",
)  # fmt: skip
_MOST_LAYERS = 64
"""A ray is followed through so many surfaces."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is behind each pixel of a sonar image, all of shape (bins, beams).

    Attributes:
        labels: Names of the scene's bodies.
        label: int32, index into ``labels`` of the strongest contribution; -1 where nothing echoes.
        elevation_rad: float32, its elevation in the sonar frame: what the image loses; not a
            number where nothing echoes.  Good to half a sample, like the point.
        range_m: float32, its range within the bin.
        point_m: (bins, beams, 3) float32, its surface point, world frame.
        first_return: The nearest cell of each beam that echoes.
        shadow: Cells that show nothing although there are surfaces, since others hide them.  Of a
            closed body only where it begins counts, not where it ends.
    """

    labels: tuple[str, ...]
    label: Int32
    elevation_rad: Float32
    range_m: Float32
    point_m: Float32
    first_return: Bool
    shadow: Bool


def find_truth(sets: list[Samples], scene: Scene, geometry: FanGeometry, pose: Pose) -> Truth:
    """The truth of an image of direct echoes, from a renderer's samples.

    Args:
        sets: What the renderer sampled.
        scene: Of what.
        geometry: Of the sonar.
        pose: Of the vehicle.
    """
    which = strongest(sets, geometry)
    shown = which >= 0
    chosen = which[shown]
    direction = np.concatenate([s.direction for s in sets])[chosen]
    reach_m = np.concatenate([(s.rise_m + s.skew_m) / 2 for s in sets])[chosen]
    middle_m = np.concatenate([s.range_m for s in sets])[chosen]
    bins = np.broadcast_to(np.arange(geometry.bins)[:, None], which.shape)[shown]
    near_m = geometry.range_min_m + bins * geometry.bin_m
    low_m = np.maximum(near_m, middle_m - reach_m)
    high_m = np.minimum(near_m + geometry.bin_m, middle_m + reach_m)
    here_m = ((low_m + high_m) / 2).astype(np.float32)
    transform = world_from_sonar(pose, geometry.mount)
    point = (direction * here_m[:, None]) @ transform[:3, :3].T + transform[:3, 3]

    label = np.full(which.shape, -1, np.int32)
    label[shown] = np.concatenate([s.body for s in sets])[chosen]
    elevation_rad, range_m = (np.full(which.shape, np.nan, np.float32) for _ in range(2))
    elevation_rad[shown] = np.arcsin(np.clip(direction[:, 2], -1.0, 1.0))
    range_m[shown] = here_m
    point_m = np.full((*which.shape, 3), np.nan, np.float32)
    point_m[shown] = point
    first = np.zeros(which.shape, np.bool_)
    beams = np.flatnonzero(shown.any(axis=0))
    first[shown.argmax(axis=0)[beams], beams] = True
    seen = gather(sets, geometry).coverage > 0.0
    shadow = (_hidden(scene, geometry, pose) > 0.0) & ~seen
    return Truth(scene.labels, label, elevation_rad, range_m, point_m, first, shadow)


def label_colours(count: int) -> Float32:
    """A colour (count, 3) in [0, 1] for each label, told apart easily; ten in turn."""
    table = np.array([list(bytes.fromhex(code)) for code in _COLOURS], np.float32) / 255.0
    return table[np.arange(count) % len(table)]


def _hidden(scene: Scene, geometry: FanGeometry, pose: Pose) -> Float32:
    """Coverage (bins, beams) of hidden surfaces: those beyond the first that a ray meets.

    Where a ray leaves a closed body, at every second meeting with it, is nothing to be seen.  Rays
    are as dense as the image's own: behind a crest, what is hidden may be lower than a patch.
    """
    sampling = SamplingSettings()
    grid = even_grid(geometry, *even_samples(geometry, sampling))
    view = View(scene, geometry, world_from_sonar(pose, geometry.mount)[None], Response())
    hits, _ = view.cast(grid.directions, np.zeros(len(grid.directions), np.int32))
    even = np.arange(geometry.beams + 1) * (len(grid.directions) // geometry.beams)
    sets = _behind(view, grid.directions, hits, even, grid.step_az, grid.step_el)
    rough, parts = rough_patches(view, grid, grid.directions, hits), sampling.refine
    if rough.any():
        directions, starts, ping = divided_patches(view, grid, rough, parts)
        hits, _ = view.cast(directions, ping)
        steps = grid.step_az / parts, grid.step_el / parts
        sets += _behind(view, directions, hits, starts, *steps)
    return gather(sets, geometry).coverage


def _behind(
    view: View, directions: Float32, hits: Hits, starts: Int64, step_az: float, step_el: float
) -> list[Samples]:
    """Samples of what rays meet beyond their first hits; beams' rays begin at ``starts``."""
    scene, transform = view.scene, view.transform
    turn = transform[:3, :3].astype(np.float32)
    world = turned(directions, turn[None], np.zeros(len(directions), np.int32))
    limit_m = BEYOND * view.geometry.range_max_m
    passed_m = np.zeros(len(world), np.float32)
    met_before = np.zeros((len(world), len(scene.meshes)), np.uint8)
    closed = np.zeros(len(scene.meshes), np.bool_)
    closed[: len(scene.bodies)] = [body.mesh.is_watertight for body in scene.bodies]
    ray = np.arange(len(world))
    sets: list[Samples] = []
    for layer in range(_MOST_LAYERS):
        if layer > 0:
            origins = transform[:3, 3] + world[ray] * passed_m[ray, None].astype(np.float64)
            hits = scene.cast(origins, world[ray], limit_m)
        total_m = passed_m[ray] + hits.range_m
        met = (hits.body >= 0) & (total_m < limit_m)
        ray, total_m, body = ray[met], total_m[met], hits.body[met]
        if not len(ray):
            break
        counts = (met_before[ray, body] % 2 == 0) | ~closed[body]
        met_before[ray, body] += 1
        if layer > 0:
            normal = hits.normal[met] @ turn
            behind = Hits(total_m, normal, body, hits.triangle[met], hits.uv[met])
            first = np.searchsorted(ray, starts)
            weight = counts.astype(np.float32)
            sets.append(
                view.samples(first, directions[ray], behind, normal, weight, step_az, step_el)
            )
        passed_m[ray] = total_m + np.maximum(np.float32(1e-3), np.float32(1e-5) * total_m)
    return sets
