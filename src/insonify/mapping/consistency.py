"""Which of two ways to take a recording contradicts itself less.

Two measures, of pairs of pings that lie otherwise to each other in one way than in the other:

- *contradiction*: the share of echoes above the floor whose whole arc of elevations other pings
  see to be free water: nearer than their first echo, or before a floor that is lit behind it;
- *likeness*: the correlation of a ping with what the others show at the same places, the most
  alike of each arc, after each range's mean has been taken away.

A pair of pings whose images lie on each other alike in both ways tells nothing and is left out; so
a track that is its own mirror image decides nothing, whatever was seen from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from insonify.types import Array, Bool, FanGeometry, Float64, Int64

_ELEVATIONS = 9
_PIXELS = 300
"""Of each ping that are looked at, for each measure."""
_BEAMS_OFF, _METRES_OFF = 2.0, 0.3
"""A pair tells something if a place moves by as much in an image."""
_MARGIN_M = 0.15
"""Water is free up to so far before the first echo."""
_ABOVE_FLOOR_M = 0.3
_LEVEL_STEP_M = 0.1
_AROUND = 2
"""Bins on each side of where a ray reaches the floor; all but one of them must be lit."""
_LEAST_SHARED = 30
"""Pixels that others must see for a likeness to be told."""
_LEAST_PINGS = _LEAST_ECHOES = 5
_MIRROR = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A way to take pings: where each was, and which way its columns run.

    Attributes:
        world_from_sonar: (pings, 4, 4); NaN where a ping has no place.
        mirrored: Whether columns run from starboard to port.
    """

    world_from_sonar: Float64
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class Verdict:
    """How much better one view is than another, by each measure.

    Attributes:
        gains: Contradiction spared, likeness won, in the mean of pings.
        sigmas: Those over their standard errors; 0 where nothing tells.
        pings: How many pings tell something.
    """

    gains: tuple[float, float]
    sigmas: tuple[float, float]
    pings: int


class PingStack:
    """Pings of one fan, prepared to be compared with each other."""

    def __init__(self, fan: FanGeometry, images: Sequence[Array], lit: float) -> None:
        """From images (bins, beams) of a fan, whose pixels above ``lit`` are echoes."""
        self.fan = fan
        self._lit = np.stack(images) > lit
        smooth = [uniform_filter(np.sqrt(image), (5, 3)) for image in images]
        self._contrast = np.stack([one - one.mean(axis=1, keepdims=True) for one in smooth])
        pair = self._lit.copy()
        pair[:, :-1] &= self._lit[:, 1:]
        self._first = np.where(pair.any(axis=1), pair.argmax(axis=1), fan.bins)
        self._near_m = self._range_m(self._least_of_three(self._first)) - _MARGIN_M
        self._floor_lit = _mostly_lit(self._lit)
        half = 0.4995 * fan.elevation_fov_rad
        elevation = np.linspace(-half, half, _ELEVATIONS)[:, None]
        azimuth = fan.beam_azimuths_rad[None, :]
        self._rays = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation) + 0.0 * azimuth,
            ],
            axis=-1,
        )
        self._chosen = [self._choose(number) for number in range(len(images))]

    def contest(self, one: View, other: View) -> Verdict:
        """How much better ``one`` agrees with itself than ``other``."""
        there = np.isfinite(one.world_from_sonar).all(axis=(1, 2))
        there &= np.isfinite(other.world_from_sonar).all(axis=(1, 2))
        numbers = np.flatnonzero(there)
        tells = self._telling(one, other, numbers)
        first, second = _Judge(self, one, numbers), _Judge(self, other, numbers)
        gains = [
            first.score(number, others) - second.score(number, others)
            for number in map(int, numbers)
            if len(others := numbers[tells[number, numbers]])
        ]
        table = np.array(gains).reshape(-1, 2)
        means, sigmas = zip(*(_mean(column) for column in table.T), strict=True)
        known = int(np.isfinite(table).any(axis=1).sum())
        return Verdict((means[0], means[1]), (sigmas[0], sigmas[1]), known)

    def contradictions(self, view: View) -> Float64:
        """The share of each ping's echoes that others contradict, (pings,); NaN if it has none."""
        numbers = np.flatnonzero(np.isfinite(view.world_from_sonar).all(axis=(1, 2)))
        judge = _Judge(self, view, numbers)
        shares = np.full(len(view.world_from_sonar), np.nan)
        for number in map(int, numbers):
            shares[number] = judge.contradiction(number, numbers[numbers != number])
        return shares

    def floor(self, view: View) -> tuple[float, float, bool]:
        """A level of first echoes: the share of beams that agree, its height, whether it is above.

        A height of metres in the world, above the sonar if the sonar looks up.
        """
        numbers = np.flatnonzero(np.isfinite(view.world_from_sonar).all(axis=(1, 2)))
        judge = _Judge(self, view, numbers)
        return judge.floor_share, judge.sign * judge.level, judge.sign > 0.0

    def rays(self, mirrored: bool) -> Float64:
        """Directions in the sonar, (elevations, beams, 3)."""
        return self._rays * _MIRROR if mirrored else self._rays

    def first_m(self, number: int) -> Float64:
        """Range of each beam's first echo, (beams,); infinite where there is none."""
        first = self._first[number]
        return np.where(first < self.fan.bins, self._range_m(first), np.inf)

    def chosen(self, number: int) -> tuple[Int64, Int64]:
        """Pixels (n, 2) of a ping that are compared: echoes, and what stands out or lies anywhere.

        The same for every view, so that views are compared on the same pixels.
        """
        return self._chosen[number]

    def _choose(self, number: int) -> tuple[Int64, Int64]:
        rng = np.random.default_rng(number)
        echoes = np.argwhere(self._lit[number])
        echoes = echoes[rng.permutation(len(echoes))[: 4 * _PIXELS]]
        strength = np.abs(self._contrast[number]).ravel()
        strong = np.flatnonzero(strength >= np.quantile(strength, 0.9))
        picked = [rng.choice(strong, _PIXELS), rng.integers(0, strength.size, _PIXELS)]
        places = np.unravel_index(np.concatenate(picked), (self.fan.bins, self.fan.beams))
        return echoes, np.stack(places, axis=1)

    def at(self, number: int, bins: Int64, beams: Int64) -> Array:
        """Contrast of a ping at pixels."""
        return np.asarray(self._contrast[number][bins, beams])

    def free_before(self, number: int, beams: Int64) -> Float64:
        """Range in metres up to which the water in beams, and in those beside them, is free."""
        return np.asarray(self._near_m[number][beams], np.float64)

    def lit_floor(self, number: int, bins: Int64, beams: Int64) -> Bool:
        """Whether nearly all is lit around pixels, and in the beams beside them."""
        return np.asarray(self._floor_lit[number][bins, beams], np.bool_)

    def pixel(self, points: Float64, mirrored: bool) -> tuple[Float64, Int64, Int64, Bool]:
        """Range, bin and beam of points (..., 3) in the sonar, and whether they are in view."""
        fan = self.fan
        ranges: Float64 = np.sqrt(np.einsum("...i,...i->...", points, points))
        azimuth = np.arctan2(points[..., 1], points[..., 0]) * (-1.0 if mirrored else 1.0)
        height = np.abs(points[..., 2]) <= ranges * math.sin(0.48 * fan.elevation_fov_rad)
        inside = height & (np.abs(azimuth) < 0.49 * fan.azimuth_fov_rad)
        inside &= (ranges > fan.range_min_m) & (ranges < fan.range_max_m)
        beams = ((0.5 * fan.azimuth_fov_rad - azimuth) / fan.beam_rad).astype(np.int64)
        return ranges, self.bin_of(ranges), np.clip(beams, 0, fan.beams - 1), inside

    def bin_of(self, ranges_m: Float64) -> Int64:
        """Bins of ranges, the nearest ones there are."""
        bins = (ranges_m - self.fan.range_min_m) / self.fan.bin_m
        return np.clip(bins, 0, self.fan.bins - 1).astype(np.int64)

    def ranges_of(self, pixels: Int64) -> Float64:
        """Ranges in metres of pixels (n, 2)."""
        return self._range_m(pixels[:, 0])

    def _range_m(self, bins: Int64) -> Float64:
        return np.asarray(self.fan.range_min_m + (bins + 0.5) * self.fan.bin_m, np.float64)

    @staticmethod
    def _least_of_three(first: Int64) -> Int64:
        padded = np.pad(first, ((0, 0), (1, 1)), mode="edge")
        return np.minimum(np.minimum(padded[:, :-2], padded[:, 2:]), first)

    def _telling(self, one: View, other: View, numbers: Int64) -> Bool:
        """Which pairs (pings, pings) lie otherwise to each other in two views."""
        fan = self.fan
        middle = fan.range_min_m + 0.6 * (fan.range_max_m - fan.range_min_m)
        places = middle * self._rays[:: _ELEVATIONS // 2, :: max(1, fan.beams // 4)].reshape(-1, 3)
        count = len(one.world_from_sonar)
        tells = np.zeros((count, count), np.bool_)
        for number in numbers:
            images = []
            for view in (one, other):
                side = _MIRROR if view.mirrored else 1.0
                place = view.world_from_sonar[number]
                world = (places * side) @ place[:3, :3].T + place[:3, 3]
                away = world[None] - view.world_from_sonar[numbers][:, None, :3, 3]
                local = np.einsum("npj,njk->npk", away, view.world_from_sonar[numbers][:, :3, :3])
                local *= side
                images.append(
                    (np.linalg.norm(local, axis=-1), np.arctan2(local[..., 1], local[..., 0]))
                )
            (ranges, turns), (ranges_too, turns_too) = images
            turned = np.abs(np.remainder(turns - turns_too + np.pi, 2 * np.pi) - np.pi)
            off = np.maximum(
                np.abs(ranges - ranges_too) / _METRES_OFF, turned / (_BEAMS_OFF * fan.beam_rad)
            )
            tells[number, numbers] = off.mean(axis=1) > 1.0
            tells[number, number] = False
        return tells


def _mean(values: Float64) -> tuple[float, float]:
    """Mean of what is known, and that over its standard error; 0 where too little is."""
    known = values[np.isfinite(values)]
    if len(known) < _LEAST_PINGS or known.std() == 0.0:
        return 0.0, 0.0
    mean = float(known.mean())
    return mean, mean / (float(known.std(ddof=1)) / math.sqrt(len(known)))


def _mostly_lit(lit: Bool) -> Bool:
    """Whether all but one of the bins around each pixel are lit, also in the beams beside it."""
    bins = lit.shape[1]
    sums = np.cumsum(np.pad(lit.astype(np.int32), ((0, 0), (1, 0), (0, 0))), axis=1)
    number = np.arange(bins)
    low, high = np.clip(number - _AROUND, 0, bins), np.clip(number + _AROUND + 1, 0, bins)
    mostly = (sums[:, high] - sums[:, low]) >= 2 * _AROUND
    padded = np.pad(mostly, ((0, 0), (0, 0), (1, 1)), mode="edge")
    return padded[:, :, :-2] & padded[:, :, 2:] & mostly


class _Judge:
    """Scores the pings of a stack in one view."""

    def __init__(self, stack: PingStack, view: View, numbers: Int64) -> None:
        self._stack, self._view = stack, view
        self._rays = stack.rays(view.mirrored)
        axes = view.world_from_sonar[numbers][:, 2, 0]
        self.sign = 1.0 if len(axes) and axes.mean() > 1e-6 else -1.0
        """Upwards, if the sonar looks up."""
        self.level, self.floor_share = self._floor(numbers)

    def _floor(self, numbers: Int64) -> tuple[float, float]:
        """The level, times the sign, on which most beams have their first echo; and their share."""
        heights = [np.zeros(0)]
        for number in numbers:
            view = self._view.world_from_sonar[number]
            steepest = (self.sign * (self._rays @ view[2, :3])).max(axis=0)
            heights.append(self.sign * view[2, 3] + steepest * self._stack.first_m(number))
        flat = np.concatenate(heights)
        flat = flat[np.isfinite(flat)]
        if len(flat) == 0:
            return math.inf, 0.0
        edges = np.arange(flat.min(), flat.max() + 2 * _LEVEL_STEP_M, _LEVEL_STEP_M)
        peak = edges[np.histogram(flat, edges)[0].argmax()] + _LEVEL_STEP_M / 2
        near = flat[abs(flat - peak) < 3 * _LEVEL_STEP_M]
        return float(np.median(near)), len(near) / len(flat)

    def score(self, number: int, others: Int64) -> Float64:
        """Contradiction, negative, and likeness of a ping with others; NaN where nothing tells."""
        return np.array([-self.contradiction(number, others), self._likeness(number, others)])

    def contradiction(self, number: int, others: Int64) -> float:
        """The share of a ping's echoes off the floor that others contradict; NaN if too few are."""
        echoes = self._above_floor(number, self._stack.chosen(number)[0])[:_PIXELS]
        if len(echoes) < _LEAST_ECHOES:
            return math.nan
        arcs = self._arcs(number, echoes)
        free = np.zeros(arcs.shape[:2], np.bool_)
        for other in others:
            ranges, _, beams, inside = self._seen(other, arcs)
            if inside.any():
                free |= inside & self._free(other, arcs, ranges, beams)
        return float(free.all(axis=0).mean())

    def _likeness(self, number: int, others: Int64) -> float:
        places = self._stack.chosen(number)[1]
        arcs = self._arcs(number, places)
        total = np.zeros(arcs.shape[:2])
        looks = np.zeros(arcs.shape[:2], np.int64)
        for other in others:
            _, bins, beams, inside = self._seen(other, arcs)
            total += np.where(inside, self._stack.at(other, bins, beams), 0.0)
            looks += inside
        shared = (looks > 0).any(axis=0)
        if shared.sum() < _LEAST_SHARED:
            return math.nan
        best = np.where(looks > 0, total / np.maximum(looks, 1), -np.inf).max(axis=0)[shared]
        own = self._stack.at(number, places[:, 0], places[:, 1])[shared]
        if own.std() == 0.0 or best.std() == 0.0:
            return math.nan
        return float(np.corrcoef(own, best)[0, 1])

    def _seen(self, other: int, arcs: Float64) -> tuple[Float64, Int64, Int64, Bool]:
        """Where points of arcs lie in a ping, as `PingStack.pixel` tells."""
        place = self._view.world_from_sonar[other]
        return self._stack.pixel((arcs - place[:3, 3]) @ place[:3, :3], self._view.mirrored)

    def _arcs(self, number: int, pixels: Int64) -> Float64:
        """The arcs of pixels (n, 2) in the world, (elevations, n, 3)."""
        place = self._view.world_from_sonar[number]
        arcs = self._rays[:, pixels[:, 1]] * self._stack.ranges_of(pixels)[None, :, None]
        return np.asarray(arcs @ place[:3, :3].T + place[:3, 3], np.float64)

    def _above_floor(self, number: int, pixels: Int64) -> Int64:
        """Those of pixels whose whole arc lies off the floor."""
        place = self._view.world_from_sonar[number]
        depth = (self.sign * (self._rays[:, pixels[:, 1]] @ place[2, :3])).max(axis=0)
        lowest = depth * self._stack.ranges_of(pixels) + self.sign * place[2, 3]
        return np.asarray(pixels[lowest < self.level - _ABOVE_FLOOR_M])

    def _free(self, other: int, arcs: Float64, ranges: Float64, beams: Int64) -> Bool:
        """Which points of arcs a ping sees to be water."""
        free: Bool = ranges < self._stack.free_before(other, beams)
        height = self.sign * self._view.world_from_sonar[other][2, 3]
        fall = (self.sign * arcs[..., 2] - height) / ranges
        falling = fall > 0.02
        reach = np.where(falling, (self.level - height) / np.where(falling, fall, 1.0), 0.0)
        bins = self._stack.bin_of(np.minimum(reach, 2.0 * self._stack.fan.range_max_m))
        last = self._stack.fan.range_max_m - (_AROUND + 1) * self._stack.fan.bin_m
        behind = falling & (reach > ranges + 2 * _MARGIN_M) & (reach < last)
        return np.asarray(free | (behind & self._stack.lit_floor(other, bins, beams)))
