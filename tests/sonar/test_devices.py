from __future__ import annotations

import pytest
from pydantic import ValidationError

from insonify.errors import ConfigError
from insonify.sonar.devices import SonarDevice, sonar_preset, sonar_presets


def test_defaults_are_table_1_of_the_paper() -> None:
    device = SonarDevice()
    assert (device.azimuth_fov_deg, device.elevation_fov_deg, device.beams) == (29.0, 14.0, 96)
    assert (device.range_min_m, device.range_max_m, device.tilt_deg) == (0.0, 12.825, 30.0)
    assert device.geometry.bin_m == pytest.approx(0.025)
    assert sonar_preset("park-2025") == device


@pytest.mark.parametrize("name", sorted(sonar_presets()))
def test_every_preset_is_a_device_with_a_source(name: str) -> None:
    assert sonar_preset(name).name == name
    assert sonar_presets()[name]["source"]


def test_unknown_preset_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="park-2025"):
        sonar_preset("nonesuch")


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
    ],
)
def test_impossible_devices_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        SonarDevice.model_validate(bad)
