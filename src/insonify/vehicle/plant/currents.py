"""The water's own motion: constant, sheared with height, and slowly varying."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.types import Float64
from insonify.vehicle.description import Finite, Vector


class CurrentSettings(Settings):
    """A current, world frame (east, north, up)."""

    velocity_m_s: Vector = Field((0.0, 0.0, 0.0), description="of the water, east, north, up")
    shear_per_s: Vector = Field((0.0, 0.0, 0.0), description="its change for each metre upwards")
    shear_from_m: Finite = Field(-15.0, description="z at which velocity_m_s holds")
    varying_m_s: float = Field(
        0.0, ge=0, le=10, description="standard deviation of its slow change, east and north each"
    )
    varying_s: float = Field(120.0, gt=0, le=1e6, description="correlation time of that change")


class Current:
    """A current in time: the settings' mean plus a Gauss-Markov process, linear between draws."""

    def __init__(self, settings: CurrentSettings, rng: np.random.Generator) -> None:
        """Begin at a draw from the process's stationary distribution."""
        self._settings = settings
        self._rng = rng
        self._change = settings.varying_m_s * rng.standard_normal(2)

    def over(self, duration_s: float) -> Float64:
        """The water during the next interval, (10,), as `dynamics.advance` takes it.

        Velocity at its start, its rate of change, its change with height, the height it holds at.
        """
        settings = self._settings
        stay = math.exp(-duration_s / settings.varying_s)
        kick = settings.varying_m_s * math.sqrt(1.0 - stay * stay)
        after = stay * self._change + kick * self._rng.standard_normal(2)
        water = np.zeros(10)
        water[:3] = settings.velocity_m_s
        water[:2] += self._change
        water[3:5] = (after - self._change) / duration_s
        water[6:9] = settings.shear_per_s
        water[9] = settings.shear_from_m
        self._change = after
        return water
