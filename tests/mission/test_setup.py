from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from insonify.config.layers import parse_setting, read_layer
from insonify.config.toml import config_to_toml
from insonify.errors import ConfigError, InsonifyError, MeshError
from insonify.mission.run import execute
from insonify.mission.setup import Config, World, scenario_config, scenarios
from insonify.planning.baselines import FixedPlan
from insonify.planning.factory import PLANNERS
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.histogram import Response
from insonify.types import Nav


@pytest.mark.parametrize("name", sorted(scenarios()))
def test_every_scenario_is_a_world(name: str) -> None:
    config = scenario_config(name)
    assert config.scenario == name
    world = World(config)
    assert world.area.region.low_m < world.stage.box.low_m
    paper = scenarios()[name].get("paper")
    assert (paper is not None) == (name in ("tetrapod", "wreck"))
    assert paper is None or {"entropy", "uniform", "lawnmower"} <= set(paper)
    for planner in PLANNERS:
        layered = scenario_config(name, [{"planner": planner}])
        assert World(layered).planner().name == planner


@pytest.mark.parametrize("name", sorted(scenarios()))
def test_config_goes_through_toml_and_back(name: str, tmp_path: Path) -> None:
    config = scenario_config(name, [{"seed": 3, "object": {"yaw_deg": 12.5}}])
    text = config_to_toml(config, "scan")
    assert Config.model_validate(tomllib.loads(text)) == config
    (tmp_path / "c.toml").write_text(text)
    assert scenario_config(name, [read_layer(tmp_path / "c.toml")]) == config


DOWN = np.array([[0.0, 0.0, -1.0]], np.float32)


def test_layers_win_in_order_and_a_sonar_may_be_named() -> None:
    config = scenario_config(
        "tetrapod",
        [
            parse_setting("sonar=cerqueira-90x15"),
            parse_setting("sonar.beams=64"),
            parse_setting("mapping.voxel_m=0.2"),
            parse_setting("mapping.voxel_m=0.4"),
            parse_setting("object.mesh=shipwreck"),
        ],
    )
    assert (config.sonar.name, config.sonar.beams, config.sonar.azimuth_fov_deg) == (
        "cerqueira-90x15",
        64,
        90.0,
    )
    assert config.mapping.voxel_m == 0.4
    assert config.object.mesh == "shipwreck"


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("mapping.voxel=0.2", "mapping.voxel_m"),
        ("nonsense=1", "no setting 'nonsense'"),
        ("voxel_m=0.2", "did you mean 'mapping.voxel_m'"),
        ("image.model=physical", "did you mean 'model'"),
        ("mapping.voxel_m=-1", "greater than or equal to 0.0001, not -1"),
        ("mapping.voxel_m=nan", "mapping.voxel_m"),
        ("sonar.beams=0", "sonar.beams"),
        ("sonar.azimuth_fov_deg=0", "sonar.azimuth_fov_deg"),
        ("sonar=nonesuch", "insonify sonars"),
        ("sonar.range_min_m=20", "must exceed"),
        ("entropy.candidates=0", "entropy.candidates"),
        ("entropy.termination=1.5", "entropy.termination"),
        (
            "planner=random",
            "choose one of entropy, information, lawnmower, lawnmower-near, rosette",
        ),
        ("seed=-1", "seed"),
        ("object=3", "object"),
    ],
)
def test_bad_settings_say_which_and_why(setting: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        scenario_config("tetrapod", [parse_setting(setting)])
    assert "\n" not in str(caught.value)


def test_bad_names_and_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="did you mean 'tetrapod'"):
        scenario_config("tetrapot")
    with pytest.raises(ConfigError, match="KEY=VALUE"):
        parse_setting("mapping.voxel_m")
    with pytest.raises(ConfigError, match="no such config"):
        read_layer(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("a = = 1")
    with pytest.raises(ConfigError, match="TOML"):
        read_layer(tmp_path / "bad.toml")


def test_a_mesh_in_a_config_file_is_found_beside_it(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    (tmp_path / "c.toml").write_text('[object]\nmesh = "box.stl"\n')
    config = scenario_config("tetrapod", [read_layer(tmp_path / "c.toml")])
    assert config.object.mesh == str(tmp_path / "box.stl")
    assert World(config).stage.box.size_m == pytest.approx((1, 1, 1))


def test_an_object_smaller_than_a_voxel_is_refused(tmp_path: Path) -> None:
    trimesh.creation.box((0.01, 0.01, 0.01)).export(tmp_path / "box.stl")
    config = scenario_config("tetrapod", [{"object": {"mesh": str(tmp_path / "box.stl")}}])
    with pytest.raises(MeshError, match=r"object\.scale"):
        World(config)


def test_the_seed_shapes_the_seabed() -> None:
    a, b, c = (
        World(scenario_config("tetrapod", [{"seed": seed}])).stage.seabed.heights_m.tobytes()
        for seed in (1, 1, 2)
    )
    assert a == b != c


@pytest.mark.parametrize("name", sorted(set(scenarios()) - {"field", "wreck-part"}))
def test_no_scan_begins_with_the_object_in_view(name: str) -> None:
    """Park et al. 2025, section 4: the lawnmower starts where the object is not visible."""
    for planner in ("entropy", "uniform", "lawnmower"):
        world = World(scenario_config(name, [{"planner": planner}]))
        made = world.planner()
        paths = made.plan if isinstance(made, FixedPlan) else ()
        first = made.next_scan(world.mapper(), Nav(None, ())).path
        assert first is not None
        for path in paths or (first,):
            samples = EmbreeRenderer().sample(
                world.scene, world.sonar.device.geometry, path.waypoints[0], Response()
            )
            reach = world.sonar.device.range_max_m
            assert not any(((s.body == 0) & (s.range_m < reach)).any() for s in samples), planner


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"object": {"burial_m": 50.0}}, "below the seabed"),
        ({"seabed": {"size_m": 10.0}}, "seabed.size_m"),
        ({"seabed": {"cell_m": 0.001}}, "seabed.cell_m"),
        ({"survey": {"altitude_m": 30.0}}, "above the water"),
        ({"survey": {"floor_m": 50.0}}, "survey.floor_m"),
        ({"sampling": {"across_beam": 64, "over_elevation": 8192}}, "rays a ping"),
        ({"scenario": "wreck"}, "scenario 'wreck', not of 'tetrapod'"),
    ],
)
def test_orders_that_make_no_sense_are_refused(setting: dict[str, Any], words: str) -> None:
    with pytest.raises(InsonifyError, match=words):
        World(scenario_config("tetrapod", [setting]))


def test_the_seabed_lies_around_the_object_and_altitude_is_above_it(tmp_path: Path) -> None:
    far = World(scenario_config("tetrapod", [{"object": {"x_m": 500.0, "y_m": -300.0}}]))
    assert np.isfinite(far.scene.cast(np.array([500.0, -315.0, 0.0]), DOWN).range_m).all()
    np.save(tmp_path / "deep.npy", np.full((200, 200), -30.0))
    raster = {"raster": str(tmp_path / "deep.npy"), "depth_m": 0.0, "cell_m": 0.5}
    deep = World(scenario_config("tetrapod", [{"seabed": raster}]))
    assert deep.area.z_m == pytest.approx(-25.0)


def test_by_the_sonar_equation_echoes_begin_above_the_noise() -> None:
    """Of a sonar in empty water hardly a pixel is an echo; what is set stays."""
    physical = {"model": "physical", "sonar": {"preset": "gemini-720im"}}
    config = scenario_config("tetrapod", [physical])
    ambient = config.build(config.sonar).ambient()
    lit = (ambient > config.mapping.pixel_threshold / 255.0).mean()
    assert lit < 1e-4 and config.mapping.pixel_threshold < 200
    assert (ambient > 0.6 * config.mapping.pixel_threshold / 255.0).mean() > 1e-3
    set_ = scenario_config("tetrapod", [physical, {"mapping": {"pixel_threshold": 90}}])
    assert set_.mapping.pixel_threshold == 90
    assert scenario_config("tetrapod").mapping.pixel_threshold == 76


@pytest.mark.slow
def test_a_scan_by_the_sonar_equation_maps_as_well() -> None:
    small = {"mapping": {"voxel_m": 0.2}, "survey": {"baseline_scans": 2}, "planner": "uniform"}
    found = {
        model: execute(scenario_config("tetrapod", [small, {"model": model}])).history[-1].metrics
        for model in ("cerqueira", "physical")
    }
    f1 = {model: metrics["solid"]["exact"]["f1"] for model, metrics in found.items()}
    assert f1["physical"] > f1["cerqueira"] - 0.05
