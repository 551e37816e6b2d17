"""Simulations along routes: what comes out, when, from where."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from insonify.errors import ConfigError
from insonify.simulation import (
    Line,
    Profile,
    Simulation,
    Turn,
    View,
    build_scene,
    orbit,
    simulate,
    simulation_config,
    simulations,
    turn_starts,
    waterfall,
)
from insonify.sonar.camera import Camera

COARSE = {"sampling": {"refine": 1}}


def _config(world: str, **layer: object) -> Simulation:
    return simulation_config(world, [COARSE, layer])


@pytest.mark.parametrize("name", sorted(simulations()))
def test_the_papers_experiments_show_something(name: str) -> None:
    config = simulation_config(name, [])
    assert config.title
    for record in simulate(config, build_scene(config.world)):
        image = record.polar.image if isinstance(record, Turn) else record.ping.image  # type: ignore[union-attr]
        assert 0.01 < float((image > 0.3).mean()) < 0.9


def test_same_seed_same_image_other_seed_other_noise() -> None:
    scene = build_scene("tank")
    images = []
    for seed in (1, 1, 2):
        (view,) = simulate(_config("fls-tank", seed=seed), scene)
        assert isinstance(view, View)
        images.append(view.ping.image)
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).mean() > 0.5


def test_pings_come_at_the_devices_rate_along_a_timed_route() -> None:
    route = [[0.0, -3.0, 0.0, -2.0, 0, 0, 0], [0.1, -2.0, 0.0, -2.0, 0, 0, 0]]
    config = _config("fls-tank", route=route)
    views = [view for view in simulate(config, build_scene("tank")) if isinstance(view, View)]
    interval_s = 1 / 15  # the cap of a Gemini 720i, more than the sound's 2 x 10 m
    assert [view.ping.time_s for view in views] == pytest.approx([0.0, interval_s])
    assert views[1].pose.x_m == pytest.approx(-3.0 + 10.0 * interval_s)


def test_waypoints_without_times_ping_once_each() -> None:
    route = orbit((0.0, 0.0), -2.0, 2.0, 5, 10.0)
    config = _config("fls-tank", route=route, timed=False)
    views = list(simulate(config, build_scene("tank")))
    assert len(views) == 5
    for view in views:
        assert isinstance(view, View)
        towards = math.atan2(-view.pose.y_m, -view.pose.x_m)
        assert math.remainder(view.pose.yaw_rad - towards, math.tau) == pytest.approx(0, abs=1e-9)


def test_a_turn_has_its_truth_ping_by_ping() -> None:
    config = _config("msis-tank")
    (turn,) = simulate(config, build_scene("tank"), with_truth=True)
    assert isinstance(turn, Turn)
    assert len(turn.truths) == len(turn.pings) == 200
    seen = {turn.truths[0].labels[k] for t in turn.truths for k in np.unique(t.label) if k >= 0}
    assert {"wall east", "wall west", "wall north", "wall south", "pillar"} <= seen


def test_a_long_timed_route_has_several_turns() -> None:
    route = [[0.0, 0, 0, -2, 0, 0, 0], [11.0, 1, 0, -2, 0, 0, 0]]
    assert [start for start, _ in turn_starts(_config("msis-tank", route=route))] == [0.0, 5.0]


def test_side_scan_lines_make_a_waterfall() -> None:
    route = [[float(k), 0.5 * k, -5.0, -14.0, 0, 0, 0] for k in range(6)]
    config = _config("structures", route=route, timed=False, sonar={"preset": "sidescan"})
    lines = [line for line in simulate(config, build_scene("structures")) if isinstance(line, Line)]
    image = waterfall(lines)
    assert image.shape == (6, 2048)
    np.testing.assert_array_equal(image[-1, 1024:], lines[0].starboard.image[:, 0])
    assert image[:, :1024].mean() > 0.05


def test_a_camera_beside_a_side_scan_is_refused() -> None:
    config = _config("tank", route=[[0.0, 0, 0, -2, 0, 0, 0]], sonar={"preset": "sidescan"})
    with pytest.raises(ConfigError, match="--camera"):
        next(simulate(config, build_scene("tank"), camera=cast(Camera, object())))


def test_a_profiler_sounds_the_seabed() -> None:
    route = [[0.0, 15.0, 0.0, -12.0, 0, 0, 0]]
    config = _config("structures", route=route, sonar={"preset": "profiler"})
    (profile,) = simulate(config, build_scene("structures"))
    assert isinstance(profile, Profile)
    assert np.median(profile.points[:, 2]) == pytest.approx(-20.0, abs=0.2)


@given(
    radius=st.floats(0.1, 100), count=st.integers(1, 40), x=st.floats(-50, 50), y=st.floats(-50, 50)
)
def test_an_orbit_is_a_circle(radius: float, count: int, x: float, y: float) -> None:
    for _, px, py, *_ in orbit((x, y), -3.0, radius, count, 0.0):
        assert math.hypot(px - x, py - y) == pytest.approx(radius, rel=1e-6)


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ({}, "--pose"),
        ({"route": [[0, 0, 0, 0, 0, 0, 0]], "colour": 1}, "colour"),
        ({"route": [[0, 0, 0, 0, 0, 0, 0]], "sonar": {"preset": "nonesuch"}}, "nonesuch"),
        ({"route": [[0, 0, 0, 0, 0, 0, 0]], "sonar": {"beams": -1}}, "sonar.beams"),
        ({"route": [[0, 0, 0]]}, "route"),
        ({"route": [[0, 0, 0, 0, 0, 0, 0]], "model": "magic"}, "model"),
    ],
)
def test_impossible_settings_are_named(layer: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        simulation_config("tank", [layer])


def test_an_unknown_world_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="structures"):
        build_scene("nonesuch")
