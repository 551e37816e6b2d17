"""A vehicle's constants of motion: masses, damping, buoyancy and thrusters, for plant and control.

Notation of Fossen 2011, Handbook of Marine Craft Hydrodynamics and Motion Control.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from insonify.frames import directions_from_angles
from insonify.types import Float64
from insonify.vehicle.description import VehicleDescription

GRAVITY_M_S2 = 9.81


class Hydro(NamedTuple):
    """A vehicle's constants as kernels take them."""

    rigid: Float64
    added: Float64
    inverse: Float64
    linear: Float64
    quadratic: Float64
    centres: Float64
    weights_n: Float64
    directions: Float64
    limits: Float64


def hydro(vehicle: VehicleDescription, density_kg_m3: float) -> Hydro:
    """The constants of a vehicle in water of a density.

    ``rigid`` and ``added`` are (6, 6) mass matrices, ``inverse`` that of their sum; ``centres``
    (3, 3) has the centres of gravity, buoyancy and drag as rows; ``weights_n`` weight and
    buoyancy; ``directions`` (6, thrusters) force and moment of each unit thrust; ``limits``
    (4, thrusters) largest thrust, dead band, lag and rotor constant.
    """
    mass, arm = vehicle.mass_kg, _skew(np.array(vehicle.centre_of_gravity_m))
    rigid = np.zeros((6, 6))
    rigid[:3, :3] = mass * np.eye(3)
    rigid[:3, 3:], rigid[3:, :3] = -mass * arm, mass * arm
    rigid[3:, 3:] = np.diag(vehicle.inertia_kg_m2)
    added = np.diag(np.array(vehicle.added_mass))
    places = np.array([t.position_m for t in vehicle.thrusters])
    yaw = np.radians([t.yaw_deg for t in vehicle.thrusters])
    pitch = np.radians([t.pitch_deg for t in vehicle.thrusters])
    pushes = directions_from_angles(yaw, -pitch)
    directions = np.vstack([pushes.T, np.cross(places, pushes).T])
    limits = np.array([[t.max_n, t.dead_band_n, t.lag_s, t.rotor_n_s2] for t in vehicle.thrusters])
    centres = (vehicle.centre_of_gravity_m, vehicle.centre_of_buoyancy_m, vehicle.drag_centre_m)
    buoyancy = density_kg_m3 * vehicle.volume_m3
    return Hydro(
        rigid=rigid,
        added=added,
        inverse=np.asarray(np.linalg.inv(rigid + added), np.float64),
        linear=np.array(vehicle.linear_damping),
        quadratic=np.array(vehicle.quadratic_damping),
        centres=np.array(centres),
        weights_n=GRAVITY_M_S2 * np.array([mass, buoyancy]),
        directions=np.ascontiguousarray(directions),
        limits=np.ascontiguousarray(limits.T),
    )


def _skew(v: Float64) -> Float64:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
