"""The CPU renderer: Embree rays, gathered into an echo histogram.

A ray stands for a patch of the beam's elevation.  On a slanted surface that patch spans several
range bins, so its echo is shared among them by overlap: a level seabed then fills every bin it
covers, with far fewer rays than bins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from insonify.frames import directions_from_angles, world_from_sonar
from insonify.jit import kernel, parallel_kernel, prange
from insonify.scene import Scene
from insonify.types import FanGeometry, Float32, Int32, Pose

_LEAST_FACING = 0.1
"""Cosine of incidence below which a patch's range extent is no longer extrapolated."""


@dataclass(frozen=True, slots=True)
class Response:
    """The sigmoid S of Cerqueira et al. 2017, eq. 1: how an intensity in [0, 1] becomes an echo."""

    slope: float
    centre: float


@dataclass(frozen=True, slots=True, eq=False)
class EchoHistogram:
    """What both renderers return, before normalisation and noise.

    Attributes:
        echo_sum: (bins, beams) float32, sum of S(intensity) over the samples in a cell.
        samples: (bins, beams) float32, number of samples N in a cell, shares counted as such.
    """

    echo_sum: Float32
    samples: Float32


@dataclass(frozen=True, slots=True)
class EmbreeRenderer:
    """Renders echo histograms with rays.

    Args:
        rays_per_beam: Rays across each beam's azimuth.
        rays_in_elevation: Rays over the elevation field of view.
        response: The sigmoid of eq. 1.
    """

    rays_per_beam: int
    rays_in_elevation: int
    response: Response

    def render(self, scene: Scene, geometry: FanGeometry, pose: Pose) -> EchoHistogram:
        """The echoes of a scene from a vehicle pose (Cerqueira et al. 2017, sections 3.2, 3.3).

        A sample's intensity is the cosine between surface normal and direction to the sonar,
        times the reflectance, clipped to 1.  Either side of a triangle echoes alike.
        """
        fan = _ray_fan(geometry, self.rays_per_beam, self.rays_in_elevation)
        transform = world_from_sonar(pose, geometry.tilt_rad)
        turn = transform[:3, :3].astype(np.float32)
        hits = scene.cast(transform[:3, 3], fan.directions @ turn.T)
        echo_sum, samples = _gather(
            hits.range_m,
            hits.normal @ turn,
            hits.body,
            scene.reflectance,
            fan.directions.reshape(geometry.beams, -1, self.rays_in_elevation, 3),
            fan.edges.reshape(geometry.beams, -1, self.rays_in_elevation + 1, 3),
            geometry.range_min_m,
            geometry.bin_m,
            geometry.bins,
            geometry.elevation_fov_rad / self.rays_in_elevation,
            self.response.slope,
            self.response.centre,
        )
        return EchoHistogram(echo_sum.T, samples.T)


@dataclass(frozen=True, slots=True, eq=False)
class _RayFan:
    """Ray directions in the sonar frame, beam-major then azimuth then elevation.

    ``directions`` are the patches' middles, ``edges`` the elevations between the patches.
    """

    directions: Float32
    edges: Float32


@lru_cache(maxsize=8)
def _ray_fan(geometry: FanGeometry, rays_per_beam: int, rays_in_elevation: int) -> _RayFan:
    across = (np.arange(rays_per_beam) + 0.5) / rays_per_beam - 0.5
    azimuth = geometry.beam_azimuths_rad[:, None] - across * geometry.beam_rad
    edges = np.linspace(-0.5, 0.5, rays_in_elevation + 1) * geometry.elevation_fov_rad
    middles = (edges[1:] + edges[:-1]) / 2

    def rays(elevation: np.ndarray) -> Float32:
        grid = np.broadcast_arrays(azimuth[:, :, None], elevation)
        return directions_from_angles(*grid).reshape(-1, 3).astype(np.float32)

    return _RayFan(rays(middles), rays(edges))


@kernel
def _edge_range(range_m: float, facing: float, edge_facing: float, reach_m: float) -> float:
    """Range at which a patch's edge meets the plane of its middle, kept within ``reach_m``."""
    if edge_facing * facing <= 0.0:
        return range_m + reach_m
    edge = range_m * facing / edge_facing
    return min(max(edge, range_m - reach_m), range_m + reach_m)


@parallel_kernel
def _gather(
    range_m: Float32,
    normal: Float32,
    body: Int32,
    reflectance: Float32,
    directions: Float32,
    edges: Float32,
    range_min_m: float,
    bin_m: float,
    bins: int,
    patch_rad: float,
    slope: float,
    centre: float,
) -> tuple[Float32, Float32]:
    """Histogram the hits by beam and bin; all vectors in the sonar frame."""
    beams, columns, rays = directions.shape[:3]
    echo_sum = np.zeros((beams, bins), np.float32)
    samples = np.zeros((beams, bins), np.float32)
    for beam in prange(beams):
        for column in range(columns):
            for ray in range(rays):
                k = (beam * columns + column) * rays + ray
                if body[k] < 0:
                    continue
                n = normal[k]
                length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
                if length == 0.0:
                    continue
                d = directions[beam, column, ray]
                low = edges[beam, column, ray]
                high = edges[beam, column, ray + 1]
                facing = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / length
                intensity = min(1.0, abs(facing) * reflectance[body[k]])
                echo = 1.0 / (1.0 + math.exp(-slope * (intensity - centre)))
                middle = range_m[k]
                reach = 0.5 * middle * patch_rad / max(abs(facing), _LEAST_FACING)
                r0 = _edge_range(
                    middle, facing, (n[0] * low[0] + n[1] * low[1] + n[2] * low[2]) / length, reach
                )
                r1 = _edge_range(
                    middle,
                    facing,
                    (n[0] * high[0] + n[1] * high[1] + n[2] * high[2]) / length,
                    reach,
                )
                start = (min(r0, r1) - range_min_m) / bin_m
                stop = (max(r0, r1) - range_min_m) / bin_m
                first = max(0, math.floor(start))
                last = min(bins - 1, math.floor(stop))
                span = stop - start
                for cell in range(first, last + 1):
                    share = 1.0
                    if span > 1e-6:
                        share = (min(stop, cell + 1.0) - max(start, float(cell))) / span
                    echo_sum[beam, cell] += share * echo
                    samples[beam, cell] += share
    return echo_sum, samples
