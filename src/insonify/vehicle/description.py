"""Vehicles as data: a validated description, and those that come with insonify."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from insonify.config.layers import named_tables, read_table
from insonify.config.settings import Settings, Table, did_you_mean, validated
from insonify.errors import ConfigError

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Six = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]

MOST_THRUSTERS = 16


class Thruster(Settings):
    """A thruster: where it sits and pushes (body frame: forward, left, up), and its limits."""

    position_m: Vector
    yaw_deg: Finite = Field(0.0, description="direction of positive thrust, turned to the left")
    pitch_deg: Finite = Field(0.0, description="and then down")
    max_n: Positive = Field(description="largest thrust, either way")
    dead_band_n: NotNegative = Field(0.0, description="commands below it give no thrust")
    lag_s: Positive = Field(0.1, description="time constant of the first-order lag")
    rotor_n_s2: NotNegative = Field(
        0.0, description="k in thrust = k w|w|, the lag then on w; 0: the lag is on the thrust"
    )


def _reach(thruster: Thruster) -> tuple[float, float, float, float]:
    """Surge, sway, heave and yaw moment of a unit thrust."""
    yaw, pitch = math.radians(thruster.yaw_deg), math.radians(thruster.pitch_deg)
    surge, sway = math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw)
    x, y, _ = thruster.position_m
    return surge, sway, -math.sin(pitch), x * sway - y * surge


class VehicleDescription(Settings):
    """Fossen's 6-DOF model of a vehicle; diagonal matrices are given by their diagonals.

    Order: surge, sway, heave, roll, pitch, yaw.  Signs do not depend on whether z points up.
    """

    name: str
    size_m: tuple[Positive, Positive, Positive] = Field(description="length, width, height")
    mass_kg: Positive
    volume_m3: Positive = Field(description="of the water displaced")
    inertia_kg_m2: tuple[Positive, Positive, Positive] = Field(description="about the origin")
    centre_of_gravity_m: Vector = (0.0, 0.0, 0.0)
    centre_of_buoyancy_m: Vector
    added_mass: Six = Field(description="kg and kg m2")
    linear_damping: Six = Field(description="N s/m and N m s")
    quadratic_damping: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    drag_centre_m: Vector = Field((0.0, 0.0, 0.0), description="where the damping forces act")
    thrusters: tuple[Thruster, ...] = Field(min_length=1, max_length=MOST_THRUSTERS)

    @model_validator(mode="after")
    def _inertia_is_a_bodys(self) -> Self:
        x, y, z = sorted(self.inertia_kg_m2)
        if x + y < z:
            raise ValueError(
                f"inertia_kg_m2 {self.inertia_kg_m2}: no body has one moment larger than the sum "
                "of the other two"
            )
        return self

    @model_validator(mode="after")
    def _can_be_steered(self) -> Self:
        reach = np.array([_reach(thruster) for thruster in self.thrusters])
        if np.linalg.matrix_rank(reach, tol=1e-6) < 4:
            raise ValueError(
                f"its {len(self.thrusters)} thrusters cannot push in surge, sway, heave and yaw "
                "each by itself; add some, or turn some"
            )
        return self

    @property
    def radius_m(self) -> float:
        """Half of the largest horizontal extent: what must stay clear of things."""
        return max(self.size_m[:2]) / 2


@cache
def vehicles() -> dict[str, Table]:
    """The vehicles' tables by name, as they stand in ``config/vehicles.toml``, source and all."""
    return named_tables("vehicles")


def vehicle_named(name: str) -> VehicleDescription:
    """A vehicle known by name, or that of a TOML file, by its path.

    Raises:
        ConfigError: There is none of that name, or the file does not describe a vehicle.
    """
    if name in vehicles():
        return _described(name, name, vehicles()[name])
    path = Path(name)
    if path.suffix != ".toml":
        raise ConfigError(
            f"there is no vehicle named {name!r}{did_you_mean(name, vehicles())}, or give a TOML "
            "file"
        )
    return _described(path.stem, str(path), read_table(path, "vehicle file"))


def _described(name: str, where: str, table: Table) -> VehicleDescription:
    fields = {"name": name} | {key: value for key, value in table.items() if key != "source"}
    see = "docs/vehicle.md for the keys of a vehicle"
    return validated(VehicleDescription, fields, where=where, see=see)
