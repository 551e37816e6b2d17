"""Motion of a vehicle in water: Fossen's 6-DOF equations, integrated by Runge-Kutta of order 4.

Fossen 2011, Handbook of Marine Craft Hydrodynamics and Motion Control, eq. 6.1 to 6.9 and 8.1:

    M_RB a + C_RB(v) v + M_A (a - a_c) + C_A(v_r) v_r + D(v_r) v_r + g(attitude) = B f

v is the velocity of the body's origin and its turn rate in the body frame, v_r = v - v_c the same
relative to the water, whose own acceleration a_c along the vehicle's way (turning body, shear,
slow change) is kept.  The signs do not change between forward-right-down and forward-left-up.

The state is one vector: position (3, world), attitude quaternion (4, world from body, scalar
first), v (6), and one number for each thruster: its thrust, or its rotor's speed.
"""

from __future__ import annotations

import math

import numpy as np

from insonify.frames import attitude_from_pose
from insonify.jit import kernel
from insonify.kernels import cross, rotation_into
from insonify.types import Float64, Pose
from insonify.vehicle.description import VehicleDescription
from insonify.vehicle.model import GRAVITY_M_S2, Hydro

THRUSTERS = 13
"""Where the thrusters' part of a state begins."""
TRACE = 19
"""Columns of a trace: position, quaternion and velocity after a step, then the mean specific force
and turn rate during it (body frame), which are what an ideal IMU measures."""


def resting_state(vehicle: VehicleDescription, pose: Pose) -> Float64:
    """The state of a vehicle at rest with its thrusters still."""
    state = np.zeros(THRUSTERS + len(vehicle.thrusters))
    state[:3] = pose.position_m
    state[3:7] = attitude_from_pose(pose)
    return state


@kernel
def advance(
    state: Float64, command_n: Float64, steps: int, step_s: float, model: Hydro, water: Float64
) -> Float64:
    """Integrate some steps under constant commands; the state is changed in place.

    Args:
        state: (13 + thrusters,).
        command_n: (thrusters,) thrust asked for.
        steps: How many.
        step_s: How long each.
        model: The vehicle.
        water: (10,) see `Current.over`.

    Returns:
        (steps, TRACE).
    """
    trace = np.empty((steps, TRACE))
    goal = _thruster_goals(command_n, model.limits)
    size = len(state)
    k1, k2, k3, k4 = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    turn, mean = np.empty((3, 3)), np.empty(4)
    for step in range(steps):
        time_s = step * step_s
        q0 = state[3:7].copy()
        rotation_into(q0, turn)
        before = _times(turn, state[7:10])
        _derivative(state, goal, model, water, time_s, k1)
        _derivative(state + step_s / 2 * k1, goal, model, water, time_s + step_s / 2, k2)
        _derivative(state + step_s / 2 * k2, goal, model, water, time_s + step_s / 2, k3)
        _derivative(state + step_s * k3, goal, model, water, time_s + step_s, k4)
        state += step_s / 6 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        q1 = state[3:7]
        q1 /= math.sqrt((q1 * q1).sum())
        trace[step, :13] = state[:13]
        rotation_into(q1, turn)
        force = (_times(turn, state[7:10]) - before) / step_s
        force[2] += GRAVITY_M_S2
        mean[:] = q0 + q1
        mean /= math.sqrt((mean * mean).sum())
        rotation_into(mean, turn)
        trace[step, 13:16] = _into(turn, force)
        # the turn from q0 to q1, a vector of twice the half angle
        w = (q0 * q1).sum()
        x = q0[0] * q1[1] - q0[1] * q1[0] - q0[2] * q1[3] + q0[3] * q1[2]
        y = q0[0] * q1[2] + q0[1] * q1[3] - q0[2] * q1[0] - q0[3] * q1[1]
        z = q0[0] * q1[3] - q0[1] * q1[2] + q0[2] * q1[1] - q0[3] * q1[0]
        sine = math.sqrt(x * x + y * y + z * z)
        scale = 2.0 / step_s if sine < 1e-9 else 2.0 * math.atan2(sine, w) / (sine * step_s)
        trace[step, 16], trace[step, 17], trace[step, 18] = x * scale, y * scale, z * scale
    return trace


@kernel
def _thruster_goals(command_n: Float64, limits: Float64) -> Float64:
    """What each thruster's own number tends to: commands within limits, none in the dead band."""
    goal = np.empty(len(command_n))
    for i in range(len(command_n)):
        thrust = min(limits[0, i], max(-limits[0, i], command_n[i]))
        if abs(thrust) < limits[1, i]:
            thrust = 0.0
        if limits[3, i] > 0.0:
            goal[i] = math.copysign(math.sqrt(abs(thrust) / limits[3, i]), thrust)
        else:
            goal[i] = thrust
    return goal


@kernel
def _derivative(
    s: Float64, goal: Float64, model: Hydro, water: Float64, time_s: float, out: Float64
) -> None:
    """Time derivative of a state, into ``out``."""
    turn = np.empty((3, 3))
    rotation_into(s[3:7], turn)
    v, w = s[7:10], s[10:13]
    out[:3] = _times(turn, v)
    qw, qx, qy, qz = s[3], s[4], s[5], s[6]
    out[3] = 0.5 * (-qx * w[0] - qy * w[1] - qz * w[2])
    out[4] = 0.5 * (qw * w[0] + qy * w[2] - qz * w[1])
    out[5] = 0.5 * (qw * w[1] + qz * w[0] - qx * w[2])
    out[6] = 0.5 * (qw * w[2] + qx * w[1] - qy * w[0])
    # the water here and now, and how it changes along the vehicle's way, body frame
    flow = _into(turn, water[:3] + water[3:6] * time_s + water[6:9] * (s[2] - water[9]))
    change = _into(turn, water[3:6] + water[6:9] * out[2]) - cross(w, flow)
    relative = np.empty(6)
    relative[:3] = v - flow
    relative[3:] = w
    force = -_coriolis(model.rigid, s[7:13]) - _coriolis(model.added, relative)
    force += _times(model.added[:, :3], change)
    _add_damping(force, relative, model)
    up = turn[2]  # the world's upward axis, body frame
    weight, buoyancy = model.weights_n[0], model.weights_n[1]
    force[:3] += (buoyancy - weight) * up
    force[3:] += cross(model.centres[1], buoyancy * up) - cross(model.centres[0], weight * up)
    for i in range(len(goal)):
        own, rotor = s[13 + i], model.limits[3, i]
        thrust = rotor * own * abs(own) if rotor > 0.0 else own
        force += thrust * model.directions[:, i]
        out[13 + i] = (goal[i] - own) / model.limits[2, i]
    out[7:13] = _times(model.inverse, force)


@kernel
def _add_damping(force: Float64, relative: Float64, model: Hydro) -> None:
    """Linear and quadratic damping; that of translation acts at the centre of drag."""
    arm = model.centres[2]
    there = relative[:3] + cross(relative[3:], arm)
    drag = np.empty(3)
    for i in range(3):
        drag[i] = -(model.linear[i] + model.quadratic[i] * abs(there[i])) * there[i]
        rate = relative[3 + i]
        force[3 + i] -= (model.linear[3 + i] + model.quadratic[3 + i] * abs(rate)) * rate
    force[:3] += drag
    force[3:] += cross(arm, drag)


@kernel
def _coriolis(mass: Float64, v: Float64) -> Float64:
    """C(v) v of a mass matrix (Fossen 2011, eq. 3.46): it does no work."""
    momentum = _times(mass, v)
    out = np.empty(6)
    out[:3] = cross(v[3:], momentum[:3])
    out[3:] = cross(v[:3], momentum[:3]) + cross(v[3:], momentum[3:])
    return out


@kernel
def _times(matrix: Float64, vector: Float64) -> Float64:
    """A small matrix times a vector; quicker than the library's product at this size."""
    rows, columns = matrix.shape
    out = np.zeros(rows)
    for i in range(rows):
        for j in range(columns):
            out[i] += matrix[i, j] * vector[j]
    return out


@kernel
def _into(turn: Float64, vector: Float64) -> Float64:
    """A vector in the frame that a rotation matrix turns from: its transpose times the vector."""
    out = np.zeros(3)
    for i in range(3):
        for j in range(3):
            out[i] += turn[j, i] * vector[j]
    return out
