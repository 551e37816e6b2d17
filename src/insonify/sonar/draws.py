"""Random numbers that each pixel of an image draws for itself.

Philox 4x32-10 (Salmon, Moraes, Dror, Shaw: Parallel random numbers: as easy as 1, 2, 3, SC11) makes
four words of 32 bits from a ping's key and a pixel's counter, whatever was drawn before, so an
image is the same on any number of threads.  A table of quantiles makes a variate of a word.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy import special

from insonify.jit import kernel
from insonify.types import Float32, Float64, UInt32

CELLS = 4096
"""Of a table: as many of the same probability, and again as many in its first and its last."""
_SURE = 2.0**-33
"""Half of what a word can tell apart: the probability of what lies beyond a table."""

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)


def drawn_key(rng: np.random.Generator) -> int:
    """The key of the next ping, 64 bits; it takes one draw from the stream."""
    return int(rng.integers(0, 2**64, dtype=np.uint64))


@kernel
def draw_row(key: np.uint64, row: int, kind: int, drawn: UInt32) -> None:
    """Fill (4, n) with words: column i has those of the counter ``(i, row, kind, 0)``.

    Philox is written out here, and not called, as LLVM vectorises it so.
    """
    low, high = key & _LOW, key >> _HALF
    for i in range(drawn.shape[1]):
        a, b, c, d = np.uint64(i), np.uint64(row), np.uint64(kind), np.uint64(0)
        k0, k1 = low, high
        for _ in range(10):
            p, q = _M0 * a, _M1 * c
            a, b, c, d = (q >> _HALF) ^ b ^ k0, q & _LOW, (p >> _HALF) ^ d ^ k1, p & _LOW
            k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
        drawn[0, i], drawn[1, i], drawn[2, i], drawn[3, i] = a, b, c, d


@kernel
def variate(table: Float32, word: int) -> float:
    """What a word draws from a table of quantiles, on straight lines between them."""
    row, cell = 0, word >> np.uint32(20)
    part = np.float32(np.int32(word & np.uint32(0xFFFFF))) * np.float32(2.0**-20)
    if cell == 0 or cell == CELLS - 1:
        row = 1 if cell == 0 else 2
        cell = (word >> np.uint32(8)) & np.uint32(0xFFF)
        part = np.float32(word & np.uint32(0xFF)) * np.float32(2.0**-8)
    low = table[row, cell]
    drawn: float = low + part * (table[row, cell + 1] - low)
    return drawn


def _probabilities() -> tuple[Float64, Float64]:
    """Of a table's entries, (3, cells + 1): to be below, and above; neither is quite 0."""
    steps = np.arange(CELLS + 1) / CELLS
    below = np.stack([steps, steps / CELLS, 1.0 - (1.0 - steps) / CELLS])
    above = np.stack([1.0 - steps, 1.0 - steps / CELLS, (1.0 - steps) / CELLS])
    return np.maximum(below, _SURE), np.maximum(above, _SURE)


def _stored(quantiles: Float64) -> Float32:
    table: Float32 = quantiles.astype(np.float32)
    return table


@lru_cache(maxsize=1)
def normal_table() -> Float32:
    """Quantiles of the standard normal distribution."""
    below, above = _probabilities()
    found = np.where(below < 0.5, special.ndtri(below), -special.ndtri(above))
    return _stored(found)


@lru_cache(maxsize=8)
def gamma_table(shape: float) -> Float32:
    """Quantiles of the gamma distribution of a shape and mean 1."""
    below, above = _probabilities()
    found = np.where(
        below < 0.5, special.gammaincinv(shape, below), special.gammainccinv(shape, above)
    )
    return _stored(found / shape)


@lru_cache(maxsize=8)
def skew_normal_table(spread: float, skew: float) -> Float32:
    """Quantiles of Azzalini's skew-normal with ``delta = skew``, of mean 1, cut at 0.

    Args:
        spread: Its standard deviation, before the cut.
        skew: 0 is Gaussian; towards 1 most values are low, and a tail is high.
    """
    if spread == 0.0:
        return np.ones((3, CELLS + 1), np.float32)
    alpha = skew / math.sqrt(1.0 - skew * skew)
    x = np.linspace(-9.0, 9.0, 400_001)
    density = np.exp(-0.5 * x * x) * special.ndtr(alpha * x)
    lower = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    upper = np.concatenate([np.cumsum((density[1:] + density[:-1])[::-1])[::-1], [0.0]])
    below, above = _probabilities()
    found = np.where(
        below < 0.5,
        np.interp(below, lower / lower[-1], x),
        np.interp(-above, -upper / upper[0], x),
    )
    mean = skew * math.sqrt(2.0 / math.pi)
    scale = spread / math.sqrt(1.0 - mean * mean)
    return _stored(np.maximum(1.0 + scale * (found - mean), 0.0))
