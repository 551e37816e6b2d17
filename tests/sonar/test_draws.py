"""Counter-based noise: against Philox's known answers, and each distribution at 10^6 draws."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from scipy import stats

from insonify.sonar.draws import (
    draw_row,
    gamma_table,
    normal_table,
    skew_normal_table,
    variate,
)
from insonify.sonar.formation import ImageSettings, form_image
from insonify.sonar.histogram import EchoHistogram
from insonify.types import Float32, Float64

BEAMS, PAIRS = 512, 1024


def _philox(counter: tuple[int, ...], key: tuple[int, ...]) -> tuple[int, ...]:
    """Philox 4x32-10 by the book, in Python's integers."""
    a, b, c, d = counter
    k0, k1 = key
    for _ in range(10):
        high0, low0 = divmod(0xD2511F53 * a, 1 << 32)
        high1, low1 = divmod(0xCD9E8D57 * c, 1 << 32)
        a, b, c, d = high1 ^ b ^ k0, low1, high0 ^ d ^ k1, low0
        k0, k1 = (k0 + 0x9E3779B9) % (1 << 32), (k1 + 0xBB67AE85) % (1 << 32)
    return a, b, c, d


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0,) * 4, (0,) * 2, (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        (
            (0xFFFFFFFF,) * 4,
            (0xFFFFFFFF,) * 2,
            (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
        ),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_the_reference_has_random123s_known_answers(
    counter: tuple[int, ...], key: tuple[int, ...], answer: tuple[int, ...]
) -> None:
    assert _philox(counter, key) == answer


@pytest.mark.parametrize("key", [0, 1, 0x9B3C5D7E1F2A4681, 2**64 - 1])
def test_a_row_has_the_words_of_its_counters(key: int) -> None:
    drawn = np.empty((4, 37), np.uint32)
    draw_row(np.uint64(key), 4_000_000_000, 1, drawn)
    for i in (0, 1, 17, 36):
        own = _philox((i, 4_000_000_000, 1, 0), (key % (1 << 32), key >> 32))
        assert tuple(drawn[:, i].tolist()) == own


def _drawn(table: Float32, key: int) -> Float64:
    """2 x 10^6 variates, (4, beams, pairs)."""
    words = np.empty((4, BEAMS, PAIRS), np.uint32)
    for beam in range(BEAMS):
        draw_row(np.uint64(key), beam, 0, words[:, beam])
    found: Float64 = _variates(table, words.ravel())
    return found.reshape(words.shape)


@numba.njit
def _variates(table, words):  # type: ignore[no-untyped-def]
    found = np.empty(len(words))
    for k in range(len(words)):
        found[k] = variate(table, words[k])
    return found


SKEW = 0.9
_SCALE = 0.2 / math.sqrt(1 - 2 * SKEW**2 / math.pi)
DISTRIBUTIONS = {
    "normal": (normal_table(), stats.norm),
    "gamma 2": (gamma_table(2.0), stats.gamma(2.0, scale=0.5)),
    "gamma 0.5": (gamma_table(0.5), stats.gamma(0.5, scale=2.0)),
    "skew-normal": (
        skew_normal_table(0.2, SKEW),
        stats.skewnorm(
            SKEW / math.sqrt(1 - SKEW**2), 1 - _SCALE * SKEW * math.sqrt(2 / math.pi), _SCALE
        ),
    ),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_variates_have_their_distribution_and_its_tails(name: str) -> None:
    table, exact = DISTRIBUTIONS[name]
    drawn = np.sort(_drawn(table, 77).ravel())
    # by its own distribution function a variate is even in [0, 1]; a grid of it is enough
    at = np.linspace(0, len(drawn) - 1, 20_001).astype(int)
    off = np.abs(exact.cdf(drawn[at]) - (at + 0.5) / len(drawn)).max()
    assert off * math.sqrt(len(drawn)) < 1.63, "Kolmogorov and Smirnov at 1 %"
    for share in (1e-3, 1e-4, 1e-5):
        beyond = (drawn > exact.isf(share)).sum()
        assert beyond == pytest.approx(share * len(drawn), abs=4 * math.sqrt(share * len(drawn)))
    assert drawn.mean() == pytest.approx(exact.mean(), abs=4e-3 * exact.std())
    assert drawn.std() == pytest.approx(exact.std(), rel=4e-3)


def test_neighbours_in_range_beam_and_ping_are_independent() -> None:
    here, next_ping = _drawn(normal_table(), 5), _drawn(normal_table(), 6)
    pairs = {
        "words": (here[0], here[1]),
        "bins": (here[:, :, :-1], here[:, :, 1:]),
        "beams": (here[:, :-1], here[:, 1:]),
        "pings": (here, next_ping),
        "squares of bins": (here[:, :, :-1] ** 2, here[:, :, 1:] ** 2),
        "squares of pings": (here**2, next_ping**2),
    }
    for name, (a, b) in pairs.items():
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / math.sqrt(a.size), name


def test_a_pixel_is_the_same_alone_and_on_any_number_of_threads() -> None:
    """As in a larger image: its counter is its own."""
    ones = np.ones((100, 80), np.float32)
    large = form_image(EchoHistogram(0.5 * ones, ones), ImageSettings(), 9)
    part = EchoHistogram(0.5 * ones[:30, :20], ones[:30, :20])
    np.testing.assert_array_equal(form_image(part, ImageSettings(), 9), large[:30, :20])
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone = form_image(EchoHistogram(0.5 * ones, ones), ImageSettings(), 9)
    finally:
        numba.set_num_threads(threads)
    assert alone.tobytes() == large.tobytes()
