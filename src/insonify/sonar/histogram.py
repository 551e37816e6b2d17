"""What every renderer returns: echoes gathered by beam and range bin.

A renderer samples the beams.  Each sample stands for a patch of its beam's opening, and on a
slanted surface that patch spans a stretch of range: the echo is shared among the bins of that
stretch, so a level seabed fills every bin it covers with far fewer samples than bins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

from insonify.jit import kernel, parallel_kernel, prange
from insonify.scene import Scene
from insonify.types import FanGeometry, Float32, Int32, Int64, Pose

LEAST_FACING = 0.02
"""Cosine of incidence below which a patch's range extent is no longer extrapolated."""

BEYOND = 1.05
"""Samples are taken a little beyond the range: patches there reach back into the last bins."""

FULL_CELL = 0.1
"""A cell covered by less than this, over the number of bins, counts as partly empty."""


class Law(StrEnum):
    """How strongly a surface echoes at an angle of incidence."""

    SIGMOID = "sigmoid"
    LAMBERT = "lambert"


@dataclass(frozen=True, slots=True)
class Response:
    """From a surface's facing to the strength of its echo.

    With ``SIGMOID`` the echo is ``S(i)``, ``i`` the cosine of incidence times the reflectance R,
    clipped to 1, and S a sigmoid (Cerqueira et al. 2017, section 3.2 and eq. 1).  With ``LAMBERT``
    it is the backscatter of a patch per solid angle, ``mu cos``: Lambert's law ``mu cos^2`` over
    the patch's area, which grows as 1 / cos.

    Args:
        law: Which of the two.
        slope: Slope of S.
        centre: Intensity at which S is 0.5.
        edge_db: One-way loss at the upper and lower edge of the beam, which is Gaussian.
        lobes_edge_rad: Where that edge is, if the beam has side lobes beyond, as a line has.
        surface: Lambert's coefficient of the water's surface, seen from below; 0 does not echo.
        second_bounce: Echoes that come by way of a second surface too.
        surface_mirror: And those that come by way of the water's surface.
    """

    law: Law = Law.SIGMOID
    slope: float = 6.0
    centre: float = 0.3
    edge_db: float = 0.0
    lobes_edge_rad: float = 0.0
    surface: float = 0.0
    second_bounce: bool = False
    surface_mirror: bool = False

    @property
    def indirect(self) -> bool:
        """Whether it takes more than first hits of rays on the scene."""
        return self.second_bounce or self.surface_mirror or self.surface > 0.0

    def strengths(self, scene: Scene) -> Float32:
        """What a body's material brings into the law, by body index; the surface's comes last."""
        bodies = scene.reflectance if self.law is Law.SIGMOID else scene.lambert
        return np.append(bodies, np.float32(self.surface))

    def vector(self, geometry: FanGeometry) -> Float32:
        """For kernels and shaders: law, slope, centre, beam pattern (`beam_loss`)."""
        lambert = float(self.law is Law.LAMBERT)
        if self.lobes_edge_rad > 0.0:
            pattern = -sinc_reaches(10.0 ** (-self.edge_db / 20.0)) / math.sin(self.lobes_edge_rad)
        else:
            edges = (geometry.elevation_fov_rad / 2) ** 2
            pattern = 2.0 * self.edge_db / 10.0 * math.log(10.0) / edges
        return np.array([lambert, self.slope, self.centre, pattern], np.float32)


def sinc_reaches(level: float) -> float:
    """Where ``sin(pi u) / (pi u)`` has fallen from 1 to a level, u in [0, 1]."""
    return float(brentq(lambda u: np.sinc(u) - level, 0.0, 1.0))


@kernel
def beam_loss(elevation_rad: float, pattern: float) -> float:
    """Two-way loss of power at an elevation, of a Gaussian beam or, below 0, of a line's.

    A line's pressure falls as ``sin(pi u) / (pi u)`` with u the sine of the elevation times
    ``-pattern``, each way.
    """
    if pattern >= 0.0:
        return math.exp(-pattern * elevation_rad * elevation_rad)
    u = abs(math.pi * pattern * math.sin(elevation_rad))
    pressure = 1.0 if u < 1e-4 else math.sin(u) / u
    return pressure**4


@dataclass(frozen=True, slots=True, eq=False)
class EchoHistogram:
    """Echoes by range bin and beam, before normalisation and noise.

    Those of several pings lie side by side, (bins, pings x beams).

    Attributes:
        echo: (bins, beams) float32, sum of the samples' echoes, each weighted with the share of
            its beam's opening (azimuth x elevation) that it stands for.
        coverage: (bins, beams) float32, sum of those shares: N of Cerqueira et al., eq. 1, over
            the number of samples in a beam.
    """

    echo: Float32
    coverage: Float32


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of a scene, beam after beam.

    Attributes:
        offsets: (beams + 1,) where each beam's samples start.
        direction: (N, 3) float32 unit vectors, sonar frame.
        range_m: (N,) float32.
        rise_m: (N,) float32, range extent of the patch over its elevation.
        skew_m: (N,) float32, range extent of the patch over its azimuth.
        echo: (N,) float32, strength of the echo.
        weight: (N,) float32, share of the beam's opening; 0 where nothing was hit.
        body: (N,) int32, index of the body hit, -1 for none.
    """

    offsets: Int64
    direction: Float32
    range_m: Float32
    rise_m: Float32
    skew_m: Float32
    echo: Float32
    weight: Float32
    body: Int32


class Renderer(Protocol):
    """Samples the beams of a sonar in a scene."""

    def render(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> EchoHistogram:
        """The echoes of a scene from a vehicle pose."""

    def render_all(
        self, scene: Scene, fans: Sequence[FanGeometry], poses: Sequence[Pose], response: Response
    ) -> EchoHistogram:
        """The echoes of several pings side by side; their fans differ in their mounts alone."""

    def sample(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> list[Samples]:
        """The samples behind these echoes, for ground truth."""


def gather(sets: list[Samples], geometry: FanGeometry, pings: int = 1) -> EchoHistogram:
    """The echo histogram of sets of samples, of one or more pings of a fan."""
    echo = np.zeros((pings * geometry.beams, geometry.bins), np.float32)
    coverage = np.zeros_like(echo)
    for s in sets:
        _add_samples(
            s.offsets, s.range_m, s.rise_m, s.skew_m, s.echo, s.weight,
            geometry.range_min_m, geometry.bin_m, echo, coverage,
        )  # fmt: skip
    return EchoHistogram(echo.T, coverage.T)


def side_by_side(pings: list[EchoHistogram]) -> EchoHistogram:
    """The echo histogram of several pings."""
    return EchoHistogram(
        np.concatenate([one.echo for one in pings], axis=1),
        np.concatenate([one.coverage for one in pings], axis=1),
    )


def strongest(sets: list[Samples], geometry: FanGeometry) -> Int64:
    """Which sample gives the strongest echo of each cell, (bins, beams).

    Samples are counted through the sets; -1 where there is no echo.
    """
    best = np.zeros((geometry.beams, geometry.bins), np.float32)
    which = np.full(best.shape, -1, np.int64)
    before = 0
    for s in sets:
        _keep_strongest(
            s.offsets, s.range_m, s.rise_m, s.skew_m, s.echo, s.weight,
            geometry.range_min_m, geometry.bin_m, before, best, which,
        )  # fmt: skip
        before += len(s.range_m)
    return which.T


@kernel
def share_below(x: float, rise: float, skew: float) -> float:
    """Share of a patch's echo at less than ``x`` from its middle.

    The range over a plane patch is the sum of two even distributions, of widths ``rise`` and
    ``skew``: a trapezium.
    """
    wide, narrow = max(rise, skew), min(rise, skew)
    reach, level = 0.5 * (wide + narrow), 0.5 * (wide - narrow)
    off = abs(x)
    if off >= reach:
        above = 0.0
    elif off <= level:
        above = 0.5 - off / wide
    else:
        above = (reach - off) * (reach - off) / (2.0 * wide * narrow)
    return above if x < 0.0 else 1.0 - above


@kernel
def _stretch(
    range_m: float, rise_m: float, skew_m: float, range_min_m: float, bin_m: float
) -> tuple[float, float, float, int, int]:
    """Where a sample lies, in bins: its middle, rise and skew, and its first and last bin."""
    middle = (range_m - range_min_m) / bin_m
    rise, skew = rise_m / bin_m, skew_m / bin_m
    reach = 0.5 * (rise + skew)
    return middle, rise, skew, int(np.floor(middle - reach)), int(np.floor(middle + reach))


@parallel_kernel
def _add_samples(
    offsets: Int64,
    range_m: Float32,
    rise_m: Float32,
    skew_m: Float32,
    echo: Float32,
    weight: Float32,
    range_min_m: float,
    bin_m: float,
    echo_sum: Float32,
    coverage: Float32,
) -> None:
    """Add samples to (beams, bins) sums; a beam is written by one iteration only."""
    beams, bins = echo_sum.shape
    for beam in prange(beams):
        for k in range(offsets[beam], offsets[beam + 1]):
            if weight[k] <= 0.0:
                continue
            middle, rise, skew, first, last = _stretch(
                range_m[k], rise_m[k], skew_m[k], range_min_m, bin_m
            )
            if first == last:
                if 0 <= first < bins:
                    echo_sum[beam, first] += weight[k] * echo[k]
                    coverage[beam, first] += weight[k]
                continue
            below = 0.0 if first >= 0 else share_below(-middle, rise, skew)
            for cell in range(max(first, 0), min(last, bins - 1) + 1):
                up_to = share_below(cell + 1.0 - middle, rise, skew)
                share = weight[k] * (up_to - below)
                echo_sum[beam, cell] += share * echo[k]
                coverage[beam, cell] += share
                below = up_to


@parallel_kernel
def _keep_strongest(
    offsets: Int64,
    range_m: Float32,
    rise_m: Float32,
    skew_m: Float32,
    echo: Float32,
    weight: Float32,
    range_min_m: float,
    bin_m: float,
    before: int,
    best: Float32,
    which: Int64,
) -> None:
    """Note the samples that give more to a cell of (beams, bins) than any before."""
    beams, bins = best.shape
    for beam in prange(beams):
        for k in range(offsets[beam], offsets[beam + 1]):
            if weight[k] <= 0.0:
                continue
            middle, rise, skew, first, last = _stretch(
                range_m[k], rise_m[k], skew_m[k], range_min_m, bin_m
            )
            for cell in range(max(first, 0), min(last, bins - 1) + 1):
                share = 1.0
                if first != last:
                    share = share_below(cell + 1.0 - middle, rise, skew)
                    share -= share_below(cell - middle, rise, skew)
                given = np.float32(share * weight[k] * echo[k])
                if given > best[beam, cell]:
                    best[beam, cell] = given
                    which[beam, cell] = before + k
