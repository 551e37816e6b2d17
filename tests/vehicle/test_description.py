"""Vehicles as data: those that come along, a user's own, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from insonify.errors import ConfigError
from insonify.vehicle.description import vehicle_named, vehicles
from insonify.vehicle.model import hydro

DOCS = Path(__file__).resolve().parents[2] / "docs/vehicle.md"
OWN = """
size_m = [1.0, 0.5, 0.4]
mass_kg = 50
volume_m3 = 0.05
inertia_kg_m2 = [3.0, 4.0, 4.0]
centre_of_buoyancy_m = [0.0, 0.0, 0.02]
added_mass = [10, 20, 30, 1, 1, 1]
linear_damping = [10, 10, 10, 1, 1, 1]
thrusters = [
  { position_m = [0.1, 0.2, 0.0], max_n = 30 },
  { position_m = [0.1, -0.2, 0.0], max_n = 30 },
  { position_m = [0.0, 0.0, 0.0], yaw_deg = 90, max_n = 30 },
  { position_m = [0.0, 0.0, 0.0], pitch_deg = -90, max_n = 30 },
]
"""


@pytest.mark.parametrize("name", sorted(vehicles()))
def test_vehicles_that_come_along_name_their_source_and_can_push_every_way(name: str) -> None:
    assert len(vehicles()[name]["source"]) > 60
    vehicle = vehicle_named(name)
    reach = hydro(vehicle, 1025.0).directions[[0, 1, 2, 5]]  # surge, sway, heave, yaw
    assert np.linalg.matrix_rank(reach) == 4


def test_bluerov2_pushes_where_its_layout_says() -> None:
    reach = hydro(vehicle_named("bluerov2"), 1025.0).directions
    half = np.sqrt(0.5)
    np.testing.assert_allclose(reach[:3, 0], [half, half, 0.0], atol=1e-12)
    np.testing.assert_allclose(reach[:3, 4], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(reach[5, 0], (0.1355 + 0.1) * half)
    # the thrust line below the centre of gravity lifts the nose: negative pitch
    np.testing.assert_allclose(reach[4, 0], -0.0725 * half)


def test_a_users_own_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(OWN)
    vehicle = vehicle_named(str(path))
    assert (vehicle.name, vehicle.radius_m) == ("mine", 0.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("mass_kg = 50", "mass_kg = -1"), ["mass_kg", "greater than 0", "-1"]),
        (("mass_kg = 50", "mass_kg = nan"), ["mass_kg", "nan"]),
        (("mass_kg = 50", "weight = 1"), ["mass_kg", "required"]),
        (("mass_kg = 50", "mass_kg = 50\nbeam = 3"), ["beam", "there is no setting"]),
        (("[3.0, 4.0, 4.0]", "[1.0, 4.0, 9.0]"), ["inertia", "sum of the other two"]),
        (("[10, 20, 30, 1, 1, 1]", "[10, 20]"), ["added_mass"]),
        (("[0.1, 0.2, 0.0], max_n = 30", "[0.1, 0.2, 0.0], max_n = 0"), ["thrusters.0.max_n"]),
        (("pitch_deg = -90", "pitch_deg = 0"), ["4 thrusters cannot push", "heave"]),
        (("size_m =", "size_m"), ["cannot be read as TOML"]),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_one_sentence(
    tmp_path: Path, change: tuple[str, str], words: list[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(OWN.replace(*change))
    with pytest.raises(ConfigError) as caught:
        vehicle_named(str(path))
    for word in (str(path), *words):
        assert word in str(caught.value)
    assert "\n" not in str(caught.value).split("TOML")[0]


def test_the_example_of_the_docs_is_a_vehicle(tmp_path: Path) -> None:
    text = DOCS.read_text(encoding="utf-8")
    path = tmp_path / "docs.toml"
    path.write_text(text.split("```toml\n")[1].split("```")[0])
    assert len(vehicle_named(str(path)).thrusters) == 5


def test_unknown_names_and_missing_files() -> None:
    with pytest.raises(ConfigError, match=r"'submarine'; choose one of bluerov2"):
        vehicle_named("submarine")
    with pytest.raises(ConfigError, match="no such vehicle file"):
        vehicle_named("none.toml")
