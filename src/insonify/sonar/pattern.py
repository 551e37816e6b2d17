"""How a line array hears beams beside its own."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from insonify.types import Float32, Float64


def array_pattern(angle_rad: Float64, beam_rad: float, taper: float) -> Float64:
    """Power pattern of a line array with the taper ``1 + taper cos``, -3 dB at half ``beam_rad``.

    The transform of the taper is three sincs; uniform weights (0) give side lobes of -13 dB, a
    taper of 0.85 (Hamming) below -40 dB.
    """
    return _array_amplitude(angle_rad, beam_rad, taper) ** 2


def _array_amplitude(angle_rad: Float64, beam_rad: float, taper: float) -> Float64:
    u = np.sin(np.asarray(angle_rad)) / math.sin(beam_rad / 2) * _half_power_u(taper)
    return _tapered(u, taper)


def _tapered(u: Any, taper: float) -> Float64:
    beam: Float64 = np.sinc(u) + taper / 2.0 * (np.sinc(u - 1.0) + np.sinc(u + 1.0))
    return beam


@lru_cache(maxsize=8)
def _half_power_u(taper: float) -> float:
    """Where the pattern of a taper has fallen to one half."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        above = float(_tapered(middle, taper)) ** 2 > 0.5
        low, high = (middle, high) if above else (low, middle)
    return low


@lru_cache(maxsize=8)
def leakage(beams: int, spacing_rad: float, beam_rad: float, taper: float) -> Float32:
    """How much of each beam's pressure every beam hears, (beams, beams); it is symmetric.

    The squares of a row in the middle add up to 1, so that power is kept.
    """
    beam = np.arange(beams)
    apart = np.clip((beam[:, None] - beam) * spacing_rad, -np.pi / 2, np.pi / 2)
    heard = _array_amplitude(apart, beam_rad, taper)
    middle = math.sqrt(float((heard[beams // 2] ** 2).sum()))
    return (heard / middle).astype(np.float32)
