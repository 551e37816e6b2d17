"""Whether the poses of a recording are of the times of its pings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from insonify.io.recordings.poses import PoseTrack
from insonify.mapping.consistency import PingStack
from insonify.mission.findings import Answer, Finding, shifted, spread, track_of, view_of
from insonify.types import Float64, PosedPing

_PINGS = 40
_LEAST_PINGS = 6
_SIGMAS = 2.4
_MOST_OFFSET_S, _OFFSETS = 2.0, 17
_CLEAN, _STEEP = 0.1, 0.25
"""Of echoes, contradicted at the best offset at most, and more at others at least."""
_ALIKE = 0.05
"""Offsets with so much more contradiction fit equally well."""
_FASTEST_MPS = 10.0


def check_clock(posed: Sequence[PosedPing], lit: float, *, mirrored: bool) -> tuple[Finding, float]:
    """Whether the pings fit their poses better at other times, within two seconds.

    Told by contradiction alone; of the side that is believed, unless the other has less of it.
    """
    times = np.array([one.ping.time_s for one in posed])
    if (np.diff(times) <= 0.0).any() or _jumps(track_of(posed)):
        why = "its times do not rise, or the vehicle jumps from place to place"
        return Finding(Answer.UNKNOWN, why), 0.0
    offsets = np.linspace(-_MOST_OFFSET_S, _MOST_OFFSET_S, _OFFSETS)
    moved = [shifted(posed, float(offset_s)) for offset_s in offsets]
    common = [
        number for number in range(len(posed)) if all(one[number].pose is not None for one in moved)
    ]
    if len(common) < _LEAST_PINGS:
        return Finding(Answer.UNKNOWN, "too few pings lie well within the time of the poses"), 0.0
    few = [common[k] for k in spread(len(common), _PINGS)]
    stack = PingStack(
        posed[0].ping.geometry, [np.nan_to_num(posed[k].ping.image) for k in few], lit
    )
    curves = [
        np.array(
            [stack.contradictions(view_of([one[k] for k in few], mirrored=side)) for one in moved]
        )
        for side in (mirrored, not mirrored)
    ]
    if any(np.isnan(curve).all(axis=1).any() for curve in curves):
        return Finding(Answer.UNKNOWN, "too few echoes are seen from two places"), 0.0
    believed, other = (_dip(np.nanmean(curve, axis=1))[1] for curve in curves)
    return _lowest(offsets, curves[int(other > believed + _ALIKE)])


def _dip(curve: Float64) -> tuple[int, float]:
    """Where a curve dips most, and by how much it rises on both sides of there."""
    rises = [
        float(min(curve[:k].max(), curve[k + 1 :].max()) - curve[k])
        for k in range(1, len(curve) - 1)
    ]
    return int(np.argmax(rises)) + 1, max(rises)


def _lowest(offsets: Float64, shares: Float64) -> tuple[Finding, float]:
    """Where contradiction (offsets, pings) is least, if it rises steeply on both sides of there."""
    curve = np.nanmean(shares, axis=1)
    now = len(offsets) // 2
    least, rise = _dip(curve)
    if curve[least] > _CLEAN or rise < _STEEP:
        why = f"it is not plain where within {_MOST_OFFSET_S:g} s poses fit best"
        return Finding(Answer.UNKNOWN, why), 0.0
    low = curve <= curve[least] + _ALIKE
    first = last = least
    while first > 0 and low[first - 1]:
        first -= 1
    while last < len(offsets) - 1 and low[last + 1]:
        last += 1
    spared = shares[now] - shares[least]
    spared = spared[np.isfinite(spared)]
    if first <= now <= last or len(spared) < _LEAST_PINGS:
        return Finding(Answer.RIGHT, f"none of up to {_MOST_OFFSET_S:g} s fits better"), 0.0
    best_s = round(float(offsets[first] + offsets[last]) / 2.0, 2)
    mean, error = float(spared.mean()), float(spared.std()) / math.sqrt(len(spared))
    if mean < max(_STEEP / 2, _SIGMAS * error):
        why = f"poses {best_s:+.2f} s away fit better, but not surely"
        return Finding(Answer.UNKNOWN, why), 0.0
    why = f"poses {best_s:+.2f} s away spare {100 * mean:.0f} % of the echoes a contradiction"
    return Finding(Answer.WRONG, why), best_s


def _jumps(track: PoseTrack) -> bool:
    """Whether the vehicle is somewhere else at once, as between the scans of a simulation."""
    steps = np.diff(track.times_s)
    places = np.array([track.sample(number).position_m for number in range(len(track))])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / steps
    return bool(speeds.max() > _FASTEST_MPS)
