"""Several objects: a user's list, and a field that the seed scatters."""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from insonify.config.layers import settled
from insonify.config.toml import config_to_toml
from insonify.errors import ConfigError
from insonify.evaluation import ghosts, ground_truth
from insonify.mapping.voxels import VoxelMap
from insonify.mission.setup import World, scenario_config
from insonify.scene.named import named_scene


def field_of(**settings: Any) -> World:
    return World(scenario_config("field", [{"field": settings}]))


def test_the_seed_scatters_objects_apart_and_within_the_square() -> None:
    world = World(scenario_config("field", [{"seed": 3}]))
    bodies, region = world.stage.bodies, world.area.region
    assert len({body.name for body in bodies}) == len(bodies) == 8
    assert len({one.mesh for one in world.stage.placed}) == 7
    for body in bodies:
        assert (np.array(region.low_m[:2]) <= body.box.low_m[:2]).all()
        assert (np.array(body.box.high_m[:2]) <= region.high_m[:2]).all()
    for one, other in combinations(bodies, 2):
        gap = np.maximum(one.box.low_m, other.box.low_m) - np.minimum(
            one.box.high_m, other.box.high_m
        )
        assert math.hypot(*np.maximum(gap[:2], 0.0)) >= 1.0
    again = World(scenario_config("field", [{"seed": 3}])).stage.bodies
    assert [body.box for body in again] == [body.box for body in bodies]
    elsewhere = World(scenario_config("field", [{"seed": 4}])).stage.bodies
    assert [body.box for body in elsewhere] != [body.box for body in bodies]


def test_the_region_tells_nothing_of_where_objects_are() -> None:
    boxes = [World(scenario_config("field", [{"seed": seed}])).area.region for seed in (0, 1)]
    assert boxes[0].low_m[:2] == boxes[1].low_m[:2] == (-20.0, -20.0)
    assert boxes[0].high_m[:2] == boxes[1].high_m[:2] == (20.0, 20.0)


def test_the_number_may_be_the_seeds_too() -> None:
    counts = {
        len(World(scenario_config("field", [{"seed": seed, "field": spread}])).stage.placed)
        for spread in ({"count": 2, "count_spread": 3, "kinds": ["boxes"]},)
        for seed in range(12)
    }
    assert counts == {2, 3, 4, 5}


def test_a_field_that_is_full_says_so() -> None:
    with pytest.raises(ConfigError, match=r"no room for 60 objects.*field\.size_m"):
        field_of(count=60)
    with pytest.raises(ConfigError, match="no room"):
        field_of(count=1, size_m=1.0)


def test_a_users_own_list_is_like_the_object_but_for_what_it_says() -> None:
    objects = [{"mesh": "pipe", "x_m": -6.0}, {"mesh": "pipe", "x_m": 4.0, "burial_m": 0.3}]
    layer = {"object": {"burial_m": 0.1}, "seabed": {"relief_m": 0.0}, "objects": objects}
    config = scenario_config("tetrapod", [layer])
    world = World(config)
    assert [body.name for body in world.stage.bodies] == ["pipe", "pipe#2"]
    lows = [body.box.low_m for body in world.stage.bodies]
    np.testing.assert_allclose(lows, [(-8.5, -0.45, -20.1), (1.5, -0.45, -20.3)], atol=1e-6)
    np.testing.assert_allclose(world.area.region.low_m[:2], (-11.5, -3.45), atol=1e-6)
    np.testing.assert_allclose(world.area.region.high_m[:2], (9.5, 3.45), atol=1e-6)
    text = config_to_toml(config, "scan")
    import tomllib

    assert scenario_config("tetrapod", [tomllib.loads(text)]) == config
    with pytest.raises(ConfigError, match=r"objects\.0\.msh"):
        scenario_config("tetrapod", [{"objects": [{"msh": "pipe"}]}])


def test_files_of_lists_are_found_beside_the_config(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    table = settled(
        {"objects": [{"mesh": "box.stl"}, {"x_m": 2}], "field": {"kinds": ["pipe", "box.stl"]}},
        tmp_path,
    )
    assert table["objects"][0]["mesh"] == table["field"]["kinds"][1] == str(tmp_path / "box.stl")
    assert table["field"]["kinds"][0] == "pipe"


def test_the_truth_of_several_is_the_union_of_the_single_ones() -> None:
    world = field_of(count=3, size_m=16.0, kinds=["boxes", "tower", "amphorae"])
    bodies = world.stage.bodies
    truth = ground_truth(world.scene, bodies, 0.2)
    low = np.round(np.array(truth.box.low_m) / 0.2).astype(int)
    for name in ("surface", "solid", "scored"):
        union = np.zeros(truth.solid.shape, bool)
        for body in bodies:
            one = ground_truth(world.scene, (body,), 0.2)
            first = np.round(np.array(one.box.low_m) / 0.2).astype(int) - low
            union[tuple(map(slice, first, first + one.solid.shape))] |= getattr(one, name)
        np.testing.assert_array_equal(getattr(truth, name), union)


def test_ghosts_between_the_objects_are_counted() -> None:
    world = field_of(count=2, size_m=16.0, kinds=["boxes"])
    truth = ground_truth(world.scene, world.stage.bodies, 0.2)
    open_water = np.argwhere(~truth.scored)
    index = open_water[open_water[:, 2] == truth.scored.shape[2] - 1][0]
    place = index + np.round(np.array(truth.box.low_m) / 0.2).astype(int)
    voxels = VoxelMap(0.2)
    voxels.allocate((place // 8).astype(np.int32)[None])
    voxels.log_odds[0, int(np.ravel_multi_index(tuple(place % 8), (8, 8, 8)))] = 1.0
    count = np.count_nonzero(truth.solid & truth.scored)
    region = world.area.region.grown(1.0)
    assert ghosts(voxels.window(region), truth, world.scene) == pytest.approx(1 / count)


@pytest.mark.parametrize("area", [[1.0, 2.0, 3.0], [0.0, 0.0, -1.0, 5.0]])
def test_an_area_that_is_none_is_refused(area: list[float]) -> None:
    with pytest.raises(ConfigError, match=r"survey\.area_m|area_m"):
        scenario_config("wreck", [{"survey": {"area_m": area}}])


def test_the_region_may_hold_a_part_of_the_object() -> None:
    world = World(scenario_config("wreck-part"))
    region, box = world.area.region, world.stage.box
    assert region.low_m[1] < box.low_m[1]
    inside = region.high_m[1] - box.low_m[1]
    assert inside / box.size_m[1] == pytest.approx(1 / 3, abs=0.01)


def test_a_field_is_a_scene_by_name() -> None:
    assert len(named_scene("field").bodies) == 8
