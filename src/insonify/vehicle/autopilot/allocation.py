"""Thrust allocation: the forces asked for, shared among thrusters that can only give so much."""

from __future__ import annotations

import numpy as np

from insonify.jit import kernel
from insonify.types import Float64

CONTROLLED = (0, 1, 2, 5)
"""Surge, sway, heave and yaw: a hovering vehicle leaves roll and pitch to its righting moment."""
_RIDGE = 1e-4
_ROUNDS = 100


class Allocator:
    """Least squares within bounds, of the thrusters' forces against those asked for.

    Minimises ``|W (B f - wanted)|^2 + ridge |f|^2`` for ``|f| <= limit``, where W weighs moments by
    the vehicle's lever.  The ridge takes the smallest thrusts where several would do.
    """

    def __init__(self, directions: Float64, largest_n: Float64) -> None:
        """Prepare for a vehicle.

        Args:
            directions: (6, thrusters) force and moment of each unit thrust.
            largest_n: (thrusters,) limits, either way.
        """
        rows = np.ascontiguousarray(directions[list(CONTROLLED)])
        lever = float(np.abs(rows[3]).max()) or 1.0
        self._weights = np.array([1.0, 1.0, 1.0, 1.0 / lever])
        weighted = rows * self._weights[:, None]
        self._rows = rows
        self._weighted = weighted
        self._normal = weighted.T @ weighted + _RIDGE * np.eye(rows.shape[1])
        self._free = np.asarray(np.linalg.solve(self._normal, weighted.T), np.float64)
        self._largest = np.ascontiguousarray(largest_n)

    def share(self, wanted: Float64) -> tuple[Float64, Float64]:
        """Thrusts for forces wanted in surge, sway, heave (N) and yaw (N m).

        Returns:
            (thrusters,) thrusts, and the (4,) forces they give.
        """
        thrusts = self._free @ (self._weights * wanted)
        if (np.abs(thrusts) > self._largest).any():
            target = self._weighted.T @ (self._weights * wanted)
            thrusts = _bounded(self._normal, target, self._largest, thrusts)
        return thrusts, self._rows @ thrusts


@kernel
def _bounded(normal: Float64, target: Float64, largest: Float64, start: Float64) -> Float64:
    """Minimise f' N f / 2 - t' f within bounds by active sets.

    Thrusters that are free move together to their exact minimum, or until one of them meets its
    bound and stays there; a bound thruster whose slope points inwards is set free again.  The cost
    falls with every round, so no set of bounds comes twice and the last one is the minimum.
    """
    count = len(target)
    thrusts = np.minimum(largest, np.maximum(-largest, start))
    bound = np.abs(thrusts) >= largest
    for _ in range(_ROUNDS):
        slope = normal @ thrusts - target
        system, right = normal.copy(), -slope
        for i in range(count):
            if bound[i]:
                system[i, :] = 0.0
                system[:, i] = 0.0
                system[i, i] = 1.0
                right[i] = 0.0
        step = np.linalg.solve(system, right)
        part, first = 1.0, -1
        for i in range(count):
            if not bound[i] and abs(thrusts[i] + step[i]) > largest[i]:
                room = (largest[i] - np.sign(step[i]) * thrusts[i]) / abs(step[i])
                if room < part:
                    part, first = room, i
        thrusts = thrusts + part * step
        if first >= 0:
            thrusts[first] = np.sign(step[first]) * largest[first]
            bound[first] = True
            continue
        slope = normal @ thrusts - target
        inward, most = -1, 1e-9 * np.abs(target).max()
        for i in range(count):
            if bound[i] and slope[i] * np.sign(thrusts[i]) > most:
                inward, most = i, slope[i] * np.sign(thrusts[i])
        if inward < 0:
            break
        bound[inward] = False
    return thrusts
