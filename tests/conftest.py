"""Shared small worlds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from insonify.types import Float32, Float64, Pose
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.settings import VehicleSettings

settings.register_profile("same", derandomize=True)  # the same examples on every machine
settings.load_profile("same")

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture
def real_mesh() -> Path:
    path = DATA / "models/sunken_ship_distorted/meshes/sunkenship_distort.dae"
    if not path.is_file():
        pytest.skip(f"needs {path.name} in ../shared/data, which is not here")
    return path


FLOOR_M = -20.0


def level_bottom(origin_m: Float64, directions: Float32) -> tuple[Float64, Float64]:
    """What rays find over a level bottom."""
    down = -directions[:, 2].astype(np.float64)
    with np.errstate(divide="ignore"):
        range_m = (origin_m[2] - FLOOR_M) / down
    return np.where(down > 0.0, range_m, np.inf), np.abs(down)


@pytest.fixture
def launch() -> Callable[..., Craft]:
    def put(seed: int = 0, name: str = "bluerov2", **settings: Any) -> Craft:
        chosen = VehicleSettings.model_validate({"name": name, **settings})
        vehicle, start = vehicle_named(name), Pose(0.0, 0.0, -15.0)
        return Craft(vehicle, chosen, start, level_bottom, np.random.default_rng(seed))

    return put
