"""Shared small worlds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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
