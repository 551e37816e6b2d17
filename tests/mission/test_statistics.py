"""Against values worked out by hand, from tables, or by another library."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from insonify.mission.statistics import height_at, holm, interval, mean_height, paired_p


def test_holm_by_hand() -> None:
    # sorted 0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1: 0.04, 0.06, 0.06, 0.04, then never falling
    assert holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm([0.6, 0.9]) == [1.0, 1.0]
    assert holm([0.03]) == [0.03]
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_never_makes_a_value_smaller_and_keeps_their_order(values: list[float]) -> None:
    corrected = holm(values)
    assert all(p <= q <= 1.0 for p, q in zip(values, corrected, strict=True))
    assert all(q <= min(1.0, len(values) * p) for p, q in zip(values, corrected, strict=True))
    ranked = [q for _, q in sorted(zip(values, corrected, strict=True))]
    assert ranked == sorted(ranked)


def test_area_by_hand() -> None:
    x, y = np.array([2.0, 6.0]), np.array([0.5, 0.7])
    # triangle 0.5, trapezium 2.4, and 0.7 held for 4: 5.7 over 10
    assert mean_height(x, y, 10.0) == pytest.approx(0.57)
    # cut at 4, where the curve is 0.6: 0.5 and 1.1 over 4
    assert mean_height(x, y, 4.0) == pytest.approx(0.4)
    assert mean_height(x, y, 1.0) == pytest.approx(0.125)
    assert height_at(x, y, np.array([0.0, 1.0, 4.0, 9.0])) == pytest.approx([0, 0.25, 0.6, 0.7])


def test_a_moment_at_the_start_is_where_the_curve_begins() -> None:
    assert mean_height(np.array([0.0, 4.0]), np.array([0.4, 0.4]), 4.0) == pytest.approx(0.4)


def test_paired_against_scipy(rng: np.random.Generator) -> None:
    for count in (2, 5, 30):
        one, other = rng.normal(0.5, 0.1, count), rng.normal(0.45, 0.1, count)
        expected = stats.ttest_rel(one, other).pvalue
        assert paired_p(one - other) == pytest.approx(expected, rel=1e-9)
    assert paired_p([0.3]) is None
    assert paired_p([0.0, 0.0, 0.0]) == 1.0
    assert paired_p([0.1, 0.1]) == 0.0


def test_interval_from_the_table_of_student() -> None:
    mean, half = interval([1.0, 2.0, 3.0])
    assert mean == 2.0
    assert half == pytest.approx(4.30265 / 3**0.5, rel=1e-5)
    assert interval([5.0]) == (5.0, None)
