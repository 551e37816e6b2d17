from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from insonify.vehicle.autopilot.allocation import CONTROLLED, Allocator
from insonify.vehicle.description import vehicle_named, vehicles
from insonify.vehicle.model import hydro

share = st.floats(-1.5, 1.5)


@pytest.mark.parametrize("name", sorted(vehicles()))
@settings(max_examples=30, deadline=None)
@given(share, share, share, share)
def test_thrusts_are_the_bounded_least_squares_of_scipy(
    name: str, surge: float, sway: float, heave: float, yaw: float
) -> None:
    model = hydro(vehicle_named(name), 1025.0)
    rows, largest = model.directions[list(CONTROLLED)], model.limits[0]
    reach = np.abs(rows) @ largest
    wanted = np.array([surge, sway, heave, yaw]) * reach
    thrusts, given = Allocator(model.directions, largest).share(wanted)
    assert (np.abs(thrusts) <= largest * (1 + 1e-9)).all()
    np.testing.assert_allclose(given, rows @ thrusts, atol=1e-6 * largest.max())
    weights = np.array([1.0, 1.0, 1.0, 1.0 / np.abs(rows[3]).max()])
    matrix = np.vstack([rows * weights[:, None], 1e-2 * np.eye(len(largest))])
    target = np.concatenate([weights * wanted, np.zeros(len(largest))])
    best = lsq_linear(matrix, target, (-largest, largest), tol=1e-12)
    ours = 0.5 * float(np.sum((matrix @ thrusts - target) ** 2))
    assert ours <= best.cost * (1 + 1e-6) + 1e-6


def test_what_can_be_given_is_given() -> None:
    model = hydro(vehicle_named("bluerov2"), 1025.0)
    wanted = np.array([30.0, -20.0, 10.0, 3.0])
    thrusts, given = Allocator(model.directions, model.limits[0]).share(wanted)
    np.testing.assert_allclose(given, wanted, rtol=1e-3)
    np.testing.assert_allclose(model.directions[list(CONTROLLED)] @ thrusts, wanted, rtol=1e-3)
