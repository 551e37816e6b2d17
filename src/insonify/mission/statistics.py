"""Means with their intervals, areas under curves, paired tests, and Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from insonify.types import Float64


def interval(values: Sequence[float] | Float64) -> tuple[float, float | None]:
    """The mean, and half of Student's 95 % interval, which a single value does not have."""
    count = len(values)
    half = None
    if count > 1:
        t = float(special.stdtrit(count - 1, 0.975))
        half = t * float(np.std(values, ddof=1)) / math.sqrt(count)
    return float(np.mean(values)), half


def paired_p(differences: Sequence[float] | Float64) -> float | None:
    """The two-sided p-value of Student's paired t-test.

    Args:
        differences: One a pair.

    Returns:
        How likely a mean at least so far from 0 is, if all is chance; None for a single pair.
    """
    values = np.asarray(differences, np.float64)
    if len(values) < 2:
        return None
    mean, spread = float(values.mean()), float(values.std(ddof=1))
    if spread <= 1e-12 * abs(mean) or spread == 0.0:
        return 1.0 if mean == 0.0 else 0.0
    t = mean / (spread / math.sqrt(len(values)))
    return float(2.0 * special.stdtr(len(values) - 1, -abs(t)))


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values corrected for their number after Holm (1979), in the same order.

    The k-th smallest of n is multiplied by n - k + 1, and none is smaller than one before it.
    """
    order = np.argsort(p_values, kind="stable")
    corrected = [0.0] * len(p_values)
    largest = 0.0
    for rank, place in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[place]))
        corrected[place] = largest
    return corrected


def height_at(x: Float64, y: Float64, at: Float64) -> Float64:
    """A curve of a run, at some places.

    It goes straight from (0, 0), where nothing is known, from moment to moment; after the last it
    stays, as the map does.

    Args:
        x: (n,) where the moments are, ascending.
        y: (n,) what was reached there.
        at: (m,) places.

    Returns:
        (m,) heights.
    """
    heights: Float64 = np.interp(at, np.concatenate([[0.0], x]), np.concatenate([[0.0], y]))
    return heights


def mean_height(x: Float64, y: Float64, end: float) -> float:
    """The area under such a curve from 0 to ``end``, divided by ``end``; `height_at` says how."""
    inside = x[(x > 0.0) & (x < end)]
    at = np.concatenate([[0.0], inside, [end]])
    return float(np.trapezoid(height_at(x, y, at), at)) / end
