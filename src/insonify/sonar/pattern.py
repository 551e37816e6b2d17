"""How a line array hears beams beside its own."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from insonify.jit import kernel, parallel_kernel, prange
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
    """How much of each beam's pressure every beam hears, (beams, beams).

    The squares of a row in the middle add up to 1, so that power is kept.
    """
    beam = np.arange(beams)
    apart = np.clip((beam[:, None] - beam) * spacing_rad, -np.pi / 2, np.pi / 2)
    heard = _array_amplitude(apart, beam_rad, taper)
    middle = math.sqrt(float((heard[beams // 2] ** 2).sum()))
    return (heard / middle).astype(np.float32)


def heard_by_all(share: Float32, values: Float32) -> Float32:
    """``share @ values`` in single precision, for what beams hear of each other.

    A matrix that is the same from either end, as those of `leakage` are, mixes the sums and the
    differences of opposite beams each by themselves, which halves the work.  The order of additions
    is one for any number of threads and any processor, unlike that of a library.

    Args:
        share: (beams, beams), the same when both its axes are turned round.
        values: (beams, n).
    """
    half, turned = (len(share) + 1) // 2, share[:, ::-1]
    even = np.zeros((half, -(-half // 4) * 4), np.float32)
    odd = np.zeros_like(even)
    even[:, :half] = ((share + turned) / 2)[:half, :half]
    odd[:, :half] = ((share - turned) / 2)[:half, :half]
    found = np.empty_like(values)
    _mix(even, odd, np.ascontiguousarray(values), found)
    return found


_TILE = 256


@parallel_kernel
def _mix(even: Float32, odd: Float32, values: Float32, found: Float32) -> None:
    """Columns in tiles that stay near."""
    beams, columns = values.shape
    half, padded = even.shape
    for tile in prange((columns + _TILE - 1) // _TILE):
        start = tile * _TILE
        width = min(_TILE, columns - start)
        sums, gaps = np.zeros((padded, _TILE), np.float32), np.zeros((padded, _TILE), np.float32)
        for k in range(half):
            other = beams - 1 - k
            for j in range(width):
                one, two = values[k, start + j], values[other, start + j]
                sums[k, j] = one + two if other != k else one
                gaps[k, j] = one - two
        sum_, gap = np.empty(_TILE, np.float32), np.empty(_TILE, np.float32)
        for b in range(half):
            _weigh(even[b], sums, sum_)
            _weigh(odd[b], gaps, gap)
            for j in range(width):
                found[beams - 1 - b, start + j] = sum_[j] - gap[j]
                found[b, start + j] = sum_[j] + gap[j]


@kernel
def _weigh(weights: Float32, rows: Float32, total: Float32) -> None:
    """The weighted sum of rows, four a step, so that it vectorises."""
    total[:] = 0.0
    for k in range(0, len(weights), 4):
        w0, w1, w2, w3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        r0, r1, r2, r3 = rows[k], rows[k + 1], rows[k + 2], rows[k + 3]
        for j in range(_TILE):
            total[j] += w0 * r0[j] + w1 * r1[j] + w2 * r2[j] + w3 * r3[j]
