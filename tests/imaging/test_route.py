"""Simulations along routes: what comes out, when, from where."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from insonify.config.layers import named_tables
from insonify.errors import ConfigError
from insonify.imaging.route import (
    Line,
    Profile,
    Shot,
    Simulation,
    Turn,
    orbit,
    simulate,
    simulation_config,
    turn_starts,
)
from insonify.scene.named import named_scene
from insonify.sonar.camera import Camera
from insonify.sonar.scanning import sidescan_line, waterfall

COARSE = {"sampling": {"refine": 1}}


def _config(world: str, **layer: object) -> Simulation:
    return simulation_config(world, [COARSE, layer])


@pytest.mark.parametrize("name", sorted(named_tables("simulations")))
def test_the_papers_experiments_show_something(name: str) -> None:
    config = simulation_config(name, [])
    assert config.title
    for record in simulate(config, named_scene(config.world)):
        assert isinstance(record, Turn | Shot)
        image = record.polar.image if isinstance(record, Turn) else record.posed.ping.image
        assert 0.01 < float((image > 0.3).mean()) < 0.9


def test_same_seed_same_image_other_seed_other_noise() -> None:
    scene = named_scene("tank")
    images = []
    for seed in (1, 1, 2):
        (shot,) = simulate(_config("fls-tank", seed=seed), scene)
        assert isinstance(shot, Shot)
        images.append(shot.posed.ping.image)
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).mean() > 0.5


def test_pings_come_at_the_devices_rate_along_a_timed_route() -> None:
    route = [[0.0, -3.0, 0.0, -2.0, 0, 0, 0], [0.1, -2.0, 0.0, -2.0, 0, 0, 0]]
    config = _config("fls-tank", route=route)
    shots = [shot for shot in simulate(config, named_scene("tank")) if isinstance(shot, Shot)]
    interval_s = 1 / 15  # the cap of a Gemini 720i, more than the sound's 2 x 10 m
    assert [shot.posed.ping.time_s for shot in shots] == pytest.approx([0.0, interval_s])
    assert shots[1].posed.pose is not None
    assert shots[1].posed.pose.x_m == pytest.approx(-3.0 + 10.0 * interval_s)


def test_waypoints_without_times_ping_once_each() -> None:
    route = orbit((0.0, 0.0), -2.0, 2.0, 5, 10.0)
    config = _config("fls-tank", route=route, timed=False)
    shots = list(simulate(config, named_scene("tank")))
    assert len(shots) == 5
    for shot in shots:
        assert isinstance(shot, Shot)
        pose = shot.posed.pose
        assert pose is not None
        towards = math.atan2(-pose.y_m, -pose.x_m)
        assert math.remainder(pose.yaw_rad - towards, math.tau) == pytest.approx(0, abs=1e-9)


def test_a_turn_has_its_truth_ping_by_ping() -> None:
    config = _config("msis-tank")
    (turn,) = simulate(config, named_scene("tank"), with_truth=True)
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
    lines = [line for line in simulate(config, named_scene("structures")) if isinstance(line, Line)]
    image = waterfall(
        [sidescan_line(line.port.ping.image, line.starboard.ping.image) for line in lines]
    )
    assert image.shape == (6, 2048)
    np.testing.assert_array_equal(image[-1, 1024:], lines[0].starboard.ping.image[:, 0])
    assert image[:, :1024].mean() > 0.05


def test_a_camera_beside_a_side_scan_is_refused() -> None:
    config = _config("tank", route=[[0.0, 0, 0, -2, 0, 0, 0]], sonar={"preset": "sidescan"})
    with pytest.raises(ConfigError, match="--camera"):
        next(simulate(config, named_scene("tank"), camera=cast(Camera, object())))


def test_a_profiler_sounds_the_seabed() -> None:
    route = [[0.0, 15.0, 0.0, -12.0, 0, 0, 0]]
    config = _config("structures", route=route, sonar={"preset": "profiler"})
    (profile,) = simulate(config, named_scene("structures"))
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
        named_scene("nonesuch")
