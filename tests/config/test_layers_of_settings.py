"""Layers of settings: which wins, how presets are taken, what paths mean."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import trimesh

from insonify.config.layers import absolute, overlaid, parse_setting, read_layer
from insonify.config.settings import Table
from insonify.errors import ConfigError
from insonify.imaging.route import simulation_config
from insonify.imaging.tour import tour_config
from insonify.mission.setup import scenario_config
from insonify.sonar.devices import named_device, resolved_device

pytestmark = pytest.mark.slow


def test_a_preset_begins_a_device_anew_and_settings_after_it_change_it() -> None:
    layers: list[Table] = [{"sonar": {"beams": 3}}, {"sonar": "didson"}, {"sonar": {"bins": 7}}]
    assert overlaid(layers) == {"sonar": {"preset": "didson", "bins": 7}}
    again = overlaid([*layers, {"sonar": {"preset": "micron-dst"}}])
    assert again == {"sonar": {"preset": "micron-dst"}}


def test_every_command_resolves_a_device_in_the_same_way(tmp_path: Path) -> None:
    """By name, as a table with a preset, or as a file; only a scan mounts it tilted by default."""
    (tmp_path / "mine.toml").write_text("beams = 12\nbins = 34\nrange_max_m = 5.0\n")
    file = str(tmp_path / "mine.toml")
    route = {"route": [[0, 0, 0, -2, 0, 0, 0]]}
    flown = {"world": "tank", "waypoints": [[0, 0, -2, 0], [1, 0, -2, 0]]}
    for told in ("didson", {"preset": "didson"}, file, {"preset": file}):
        expected = named_device(told if isinstance(told, str) else told["preset"])
        scan = scenario_config("tetrapod", [{"sonar": told}]).sonar
        assert scan == expected.model_copy(update={"tilt_deg": 30.0})
        assert simulation_config("tank", [route, {"sonar": told}]).sonar == expected
        mounted = {"sonars": [{"name": "a", "rate_hz": 1, "sonar": told}]}
        assert tour_config([flown, mounted]).sonars[0].sonar == expected
    assert named_device(file).beams == 12 and named_device(file).name == "mine"
    assert resolved_device({"preset": "didson", "beams": 5})["beams"] == 5


def test_a_file_named_in_a_config_is_looked_for_beside_it(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    (tmp_path / "own.py").touch()
    text = 'world = "box.stl"\nplanner = "own.py:Mine"\nmapper = "bayes"\n'
    (tmp_path / "c.toml").write_text(text + '[object]\nmesh = "tetrapod"\n')
    layer = read_layer(tmp_path / "c.toml")
    assert layer["world"] == str(tmp_path / "box.stl")
    assert layer["planner"] == str(tmp_path / "own.py") + ":Mine"
    assert (layer["mapper"], layer["object"]["mesh"]) == ("bayes", "tetrapod")
    assert absolute("tetrapod") == "tetrapod" and absolute("module:Name") == "module:Name"


def test_settings_of_version_0_1_are_taken() -> None:
    """The figures of the Bayes mapper stood beside the voxel size."""
    old = {"mapping": {"voxel_m": 0.2, "p_free": 0.1, "p_min": 0.01}}
    mapping = scenario_config("tetrapod", [old]).mapping
    assert (mapping.voxel_m, mapping.bayes.p_free, mapping.bayes.p_min) == (0.2, 0.1, 0.01)
    single = [parse_setting("mapping.p_occupied=0.7"), parse_setting("mapping.bayes.p_free=0.2")]
    both = scenario_config("tetrapod", single).mapping.bayes
    assert (both.p_occupied, both.p_free) == (0.7, 0.2)
    with pytest.raises(ConfigError, match="p_free"):
        scenario_config("tetrapod", [{"mapping": {"p_free": 0.7}}])


def _insonify(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "insonify", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("scan", ["tetrapod"]),
        ("simulate", ["fls-tank"]),
        ("simulate", ["tank", "--for", "simulate"]),
        ("dataset", ["structures", "--for", "dataset"]),
        ("fly", ["tank", "--for", "fly"]),
    ],
)
def test_config_prints_what_the_command_takes_back(
    command: str, words: list[str], tmp_path: Path
) -> None:
    printed = _insonify("config", *words)
    assert f"insonify {command} --config" in printed
    (tmp_path / "c.toml").write_text(printed)
    again = _insonify("config", "--config", str(tmp_path / "c.toml"), "--for", command)
    assert again == printed
    told = json.loads(_insonify("config", *words, "--json"))
    table = tomllib.loads(printed)
    assert {key for key, value in told.items() if value != {}} == set(table)


def test_the_schema_describes_the_settings() -> None:
    schema = json.loads(_insonify("config", "--schema"))
    assert schema["additionalProperties"] is False
    assert "mapping" in schema["properties"] and "SonarDevice" in schema["$defs"]
    flown = json.loads(_insonify("config", "--for", "fly", "--schema"))
    assert {"world", "waypoints", "sonars"} <= set(flown["required"])
