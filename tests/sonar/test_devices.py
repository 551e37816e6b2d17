from __future__ import annotations

import pytest
from pydantic import ValidationError

from insonify.errors import ConfigError
from insonify.sonar.devices import SonarDevice, named_device, resolved_device, sonar_presets


def test_defaults_are_table_1_of_the_paper() -> None:
    device = SonarDevice()
    assert (device.azimuth_fov_deg, device.elevation_fov_deg, device.beams) == (29.0, 14.0, 96)
    assert (device.range_min_m, device.range_max_m, device.tilt_deg) == (0.0, 12.825, 30.0)
    assert device.geometry.bin_m == pytest.approx(0.025)
    assert named_device("park-2025") == device.model_copy(update={"reach_m": 12.825})


@pytest.mark.parametrize("name", sorted(sonar_presets()))
def test_every_preset_is_a_device_with_a_source(name: str) -> None:
    assert named_device(name).name == name
    assert sonar_presets()[name]["source"]


def test_an_unknown_preset_is_told_where_the_known_ones_are() -> None:
    with pytest.raises(ConfigError, match="did you mean 'park-2025'"):
        named_device("park-2024")
    with pytest.raises(ConfigError, match="insonify sonars"):
        named_device("nonesuch")


@pytest.mark.parametrize(
    "bad",
    [
        {"azimuth_fov_deg": 0.0},
        {"elevation_fov_deg": -1.0},
        {"beams": 0},
        {"bins": 0},
        {"range_min_m": 5.0, "range_max_m": 5.0},
        {"range_max_m": float("nan")},
        {"colour": "red"},
        {"reach_m": 1e-3},
        {"display_gamma": 0.01},
        {"kind": "scanning", "beams": 2},
        {"kind": "scanning", "beams": 1, "step_deg": 20.0, "sector_deg": 10.0},
    ],
)
def test_impossible_devices_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        SonarDevice.model_validate(bad)


def test_a_preset_reaches_as_far_whatever_range_is_set() -> None:
    near = resolved_device({"preset": "gemini-720im", "range_max_m": 10.0})
    assert (near["reach_m"], near["range_max_m"]) == (50.0, 10.0)
    own = resolved_device({"preset": "gemini-720im", "reach_m": 30.0})
    assert own["reach_m"] == 30.0


def test_what_is_not_confirmed_is_a_field_of_the_device() -> None:
    for name, table in sonar_presets().items():
        assert set(table["unconfirmed"]) <= set(SonarDevice.model_fields), name


def test_a_ping_takes_its_way_or_the_devices_own_time() -> None:
    gemini = named_device("gemini-720i")
    assert gemini.interval_s(1500.0) == pytest.approx(240.0 / 1500.0)
    near = gemini.model_copy(update={"range_max_m": 10.0})
    assert near.interval_s(1500.0) == pytest.approx(1 / 15)


def test_a_preset_is_mounted_as_it_is_told_unless_it_knows_better() -> None:
    assert named_device("didson").tilt_deg == 0.0
    assert named_device("didson", tilt_deg=30.0).tilt_deg == 30.0
    assert named_device("profiler", tilt_deg=30.0).tilt_deg == 90.0
