"""Dynamics against closed forms, a balance of energy, and the integrator's order."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from insonify.frames import rotation_from_attitude
from insonify.types import Float64, Pose
from insonify.vehicle.description import VehicleDescription, vehicle_named, vehicles
from insonify.vehicle.model import GRAVITY_M_S2, hydro
from insonify.vehicle.plant.currents import Current, CurrentSettings
from insonify.vehicle.plant.dynamics import advance, resting_state

STILL = np.zeros(10)
DENSITY = 1025.0


def _vehicle(**changes: Any) -> VehicleDescription:
    return vehicle_named("bluerov2").model_copy(update=changes)


def _drift(
    vehicle: VehicleDescription, state: Float64, seconds: float, step_s: float = 0.01,
    water: Float64 = STILL, command: Float64 | None = None,
) -> Float64:  # fmt: skip
    command = np.zeros(len(vehicle.thrusters)) if command is None else command
    steps = round(seconds / step_s)
    return advance(state, command, steps, step_s, hydro(vehicle, DENSITY), water)


@pytest.mark.parametrize(("mass", "sense"), [(13.0, 1.0), (15.0, -1.0)])
def test_free_rise_and_sinking_reach_the_speed_at_which_drag_balances(
    mass: float, sense: float
) -> None:
    vehicle = _vehicle(mass_kg=mass, drag_centre_m=(0.0, 0.0, 0.0))
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0))
    trace = _drift(vehicle, state, 30.0)
    net = abs(DENSITY * 0.0134 - mass) * GRAVITY_M_S2
    speed = (-33.0 + math.sqrt(33.0**2 + 4 * 190.0 * net)) / (2 * 190.0)  # 33 v + 190 v2 = net
    assert state[9] == pytest.approx(sense * speed, rel=1e-9)
    # and gets there as v_inf tanh does when there is no linear part
    plain = _vehicle(mass_kg=mass, linear_damping=(0.0,) * 6, drag_centre_m=(0.0, 0.0, 0.0))
    trace = _drift(plain, resting_state(plain, Pose(0.0, 0.0, -10.0)), 2.0)
    terminal, inertia = math.sqrt(net / 190.0), mass + 18.68
    expected = sense * terminal * np.tanh(190.0 * terminal / inertia * 0.01 * np.arange(1, 201))
    np.testing.assert_allclose(trace[:, 9], expected, rtol=1e-6)


def test_coasting_down_under_quadratic_drag() -> None:
    vehicle = _vehicle(linear_damping=(0.0,) * 6, drag_centre_m=(0.0, 0.0, 0.0))
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0))
    state[7] = 1.0
    neutral = vehicle.model_copy(update={"volume_m3": 13.5 / DENSITY})
    trace = _drift(neutral, state, 20.0)
    time = 0.01 * np.arange(1, 2001)
    length = (13.5 + 6.36) / 141.0
    np.testing.assert_allclose(trace[:, 7], 1.0 / (1.0 + time / length), rtol=1e-6)
    np.testing.assert_allclose(trace[:, 0], length * np.log1p(time / length), rtol=3e-6)


def test_small_pitch_swings_with_the_period_of_a_pendulum() -> None:
    vehicle = _vehicle(
        linear_damping=(0.0,) * 6,
        quadratic_damping=(0.0,) * 6,
        added_mass=(0.0, 0.0, 0.0, 0.189, 0.135, 0.222),
        volume_m3=13.5 / DENSITY,
    )
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0, pitch_rad=0.001))
    trace = _drift(vehicle, state, 20.0)
    stiffness = 13.5 * GRAVITY_M_S2 * 0.06
    rate = math.sqrt(stiffness / (0.23 + 0.135))
    time = 0.01 * np.arange(1, 2001)
    np.testing.assert_allclose(trace[:, 11], -0.001 * rate * np.sin(rate * time), atol=1e-7)


def test_a_drifting_vehicle_takes_on_the_currents_velocity() -> None:
    vehicle = _vehicle(volume_m3=13.5 / DENSITY)
    water = STILL.copy()
    water[:3] = 0.3, -0.2, 0.05
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0, yaw_rad=0.7))
    _drift(vehicle, state, 600.0, step_s=0.02, water=water)
    ground = rotation_from_attitude(state[3:7]) @ state[7:10]
    np.testing.assert_allclose(ground, water[:3], atol=3e-3)


@pytest.mark.parametrize("name", sorted(vehicles()))
def test_energy_never_grows_without_thrust(name: str, rng: np.random.Generator) -> None:
    vehicle = vehicle_named(name)
    model = hydro(vehicle, DENSITY)
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0, 0.4, -0.3, 1.0))
    state[7:13] = rng.normal(0.0, 0.6, 6)
    trace = _drift(vehicle, state, 20.0)

    def energy(row: Float64) -> float:
        height = [row[2] + rotation_from_attitude(row[3:7])[2] @ c for c in model.centres[:2]]
        kinetic = 0.5 * row[7:13] @ (model.rigid + model.added) @ row[7:13]
        return float(kinetic + model.weights_n[0] * height[0] - model.weights_n[1] * height[1])

    levels = np.array([energy(row) for row in trace])
    assert (np.diff(levels) <= 1e-9 * np.abs(levels).max()).all()
    assert levels[0] - levels[-1] > 0.1 * vehicle.mass_kg / 13.5


def test_without_damping_energy_stays() -> None:
    free = _vehicle(linear_damping=(0.0,) * 6, quadratic_damping=(0.0,) * 6)
    model = hydro(free, DENSITY)
    state = resting_state(free, Pose(0.0, 0.0, -10.0, 0.3, 0.2, 0.0))
    state[7:13] = 0.5, -0.3, 0.2, 0.1, -0.2, 0.3
    start = 0.5 * state[7:13] @ (model.rigid + model.added) @ state[7:13]
    up = rotation_from_attitude(state[3:7])[2]
    start += model.weights_n[0] * state[2] - model.weights_n[1] * (state[2] + up @ model.centres[1])
    _drift(free, state, 10.0)
    end = 0.5 * state[7:13] @ (model.rigid + model.added) @ state[7:13]
    up = rotation_from_attitude(state[3:7])[2]
    end += model.weights_n[0] * state[2] - model.weights_n[1] * (state[2] + up @ model.centres[1])
    assert end == pytest.approx(start, abs=1e-6)


def test_halving_the_step_divides_the_error_by_sixteen() -> None:
    vehicle = _vehicle()
    water = STILL.copy()
    water[:3], water[3:6], water[6:9] = (0.2, 0.1, 0.0), (0.01, 0.0, 0.0), (0.02, 0.0, 0.0)
    command = np.array([20.0, 12.0, -8.0, -15.0, 6.0, 9.0])

    def end(step_s: float) -> Float64:
        state = resting_state(vehicle, Pose(0.0, 0.0, -10.0))
        state[7:13] = 0.4, 0.2, 0.1, 0.02, 0.03, 0.3  # no velocity passes through zero
        _drift(vehicle, state, 0.4, step_s, water, command)
        return state

    exact = end(0.0005)
    errors = [float(np.abs(end(step) - exact).max()) for step in (0.04, 0.02, 0.01)]
    assert 3.7 < math.log2(errors[0] / errors[1]) < 4.5
    assert 3.7 < math.log2(errors[1] / errors[2]) < 4.5
    assert errors[2] < 1e-6


def test_thrusters_lag_saturate_and_have_a_dead_band() -> None:
    vehicle = _vehicle()
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0))
    command = np.array([100.0, -100.0, 0.19, 10.0, 0.0, 0.0])
    _drift(vehicle, state, 0.15, command=command)
    share = 1.0 - math.exp(-1.0)
    np.testing.assert_allclose(state[13:17], [40 * share, -40 * share, 0.0, 10 * share], rtol=1e-6)
    rotor = vehicle_named("cyclops")
    state = resting_state(rotor, Pose(0.0, 0.0, -10.0))
    _drift(rotor, state, 2.0, command=np.full(6, 50.0))
    np.testing.assert_allclose(0.00031 * state[13:] * np.abs(state[13:]), 50.0)


def test_the_trace_is_what_an_ideal_imu_measures(rng: np.random.Generator) -> None:
    """Strapdown integration of the specific force and turn rate gives the motion back."""
    vehicle = _vehicle()
    state = resting_state(vehicle, Pose(0.0, 0.0, -10.0, 0.1, 0.1, 0.5))
    state[7:13] = rng.normal(0.0, 0.3, 6)
    attitude, velocity = state[3:7].copy(), rotation_from_attitude(state[3:7]) @ state[7:10]
    trace = _drift(vehicle, state, 5.0, command=np.array([10.0, 5.0, -9.0, -4.0, 3.0, 1.0]))
    for row in trace:
        half = row[16:19] * 0.005
        angle = float(np.linalg.norm(half))
        step = np.concatenate([[math.cos(angle)], half * np.sinc(angle / math.pi)])
        w, x, y, z = attitude
        turn = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
        after = turn @ step
        middle = (attitude + after) / np.linalg.norm(attitude + after)
        velocity = velocity + 0.01 * (rotation_from_attitude(middle) @ row[13:16])
        velocity[2] -= 0.01 * GRAVITY_M_S2
        attitude = after
    np.testing.assert_allclose(attitude, state[3:7], atol=1e-9)
    np.testing.assert_allclose(
        velocity, rotation_from_attitude(state[3:7]) @ state[7:10], atol=1e-9
    )


def test_a_varying_current_has_the_spread_and_memory_it_was_given(
    rng: np.random.Generator,
) -> None:
    settings = CurrentSettings(velocity_m_s=(0.2, 0.0, 0.0), varying_m_s=0.1, varying_s=10.0)
    current = Current(settings, rng)
    east = np.array([current.over(1.0)[0] for _ in range(40000)]) - 0.2
    assert east.std() == pytest.approx(0.1, rel=0.05)
    assert (east[10:] @ east[:-10]) / (east @ east) == pytest.approx(math.exp(-1.0), abs=0.06)
    water = current.over(1.0)
    assert current.over(1.0)[0] == pytest.approx(water[0] + water[3])  # no jumps
