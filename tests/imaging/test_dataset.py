"""Datasets: the distribution of poses, and views that depend on their number alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from insonify.errors import ConfigError
from insonify.frames import world_from_sonar
from insonify.imaging.dataset import Dataset, Shots, dataset_config, standoffs_m
from insonify.imaging.route import Shot
from insonify.scene import Body, Scene
from insonify.scene.named import named_scene
from insonify.scene.seabed import procedural_seabed
from insonify.types import Pose

SONAR = {"sonar": {"beams": 24, "bins": 40, "range_max_m": 12.0}}


def _ball(seabed: bool = True) -> Scene:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    ball.apply_translation((2.0, -1.0, -18.0))
    rng = np.random.default_rng(1)
    floor = procedural_seabed(
        rng, size_m=60.0, depth_m=20.0, relief_m=0.1, correlation_m=5.0, cell_m=1.0
    )
    return Scene((Body("ball", ball),), floor if seabed else None)


def _views(scene: Scene, **poses: object) -> Shots:
    return Shots(dataset_config("tank", [SONAR, {"poses": poses}]), scene)


def test_poses_are_as_the_settings_say() -> None:
    views = _views(
        _ball(), depression_min_deg=10.0, depression_max_deg=30.0, bearing_min_deg=20.0,
        bearing_max_deg=80.0, standoff_min_m=4.0, standoff_max_m=6.0, roll_deg=3.0,
    )  # fmt: skip
    assert views.aims == (0,)
    poses = [views.pose(k) for k in range(200)]
    fan = views.geometry
    rolls, azimuths, elevations = [], [], []
    for pose in poses:
        world = world_from_sonar(pose, fan.mount)
        sonar_m = world[:3, 3]
        rolls.append(math.degrees(pose.roll_rad))
        centre = np.linalg.inv(world) @ [2.0, -1.0, -18.0, 1.0]
        range_m = float(np.linalg.norm(centre[:3]))
        assert 4.0 <= range_m <= 7.0  # the aim is on the ball's near side
        azimuths.append(math.atan2(centre[1], centre[0]))
        elevations.append(math.asin(centre[2] / range_m))
        offset = sonar_m - [2.0, -1.0, -18.0]
        bearing = math.degrees(math.atan2(offset[1], offset[0]))
        assert 20.0 - 15.0 < bearing < 80.0 + 15.0
    spread = math.asin(1.0 / 4.0)  # half of the ball, from 4 m
    assert np.abs(azimuths).max() <= 0.6 * fan.azimuth_fov_rad / 2 + spread
    assert np.abs(elevations).max() <= 0.6 * fan.elevation_fov_rad / 2 + spread
    assert np.std(rolls) == pytest.approx(3.0, rel=0.2)
    assert abs(np.mean(rolls)) < 0.8


def test_the_aim_lies_where_it_was_drawn_to_be() -> None:
    """Exactly so: the pose is solved for it, roll and tilt of the mount included."""
    config = dataset_config("tank", [{"sonar": {"tilt_deg": 25.0}}, {"poses": {"roll_deg": 15.0}}])
    views = Shots(config, _ball())
    fan = views.geometry
    for seed in range(50):
        aim = np.random.default_rng(seed).normal(size=3)
        sonar_m, pose = views._look(aim, np.random.default_rng(seed))
        again = np.random.default_rng(seed)
        standoff_m = again.uniform(*standoffs_m(config))
        bearing = math.radians(again.uniform(-180.0, 180.0))
        depression = math.radians(again.uniform(5.0, 40.0))
        azimuth = 0.6 * again.uniform(-fan.azimuth_fov_rad / 2, fan.azimuth_fov_rad / 2)
        elevation = 0.6 * again.uniform(-fan.elevation_fov_rad / 2, fan.elevation_fov_rad / 2)
        world = world_from_sonar(pose, fan.mount)
        np.testing.assert_allclose(world[:3, 3], sonar_m, atol=1e-9)
        x, y, z = (np.linalg.inv(world) @ [*aim, 1.0])[:3]
        assert math.hypot(x, y, z) == pytest.approx(standoff_m)
        assert math.atan2(y, x) == pytest.approx(azimuth, abs=1e-9)
        assert math.asin(z / standoff_m) == pytest.approx(elevation, abs=1e-9)
        away = (sonar_m - aim) / standoff_m
        assert math.asin(away[2]) == pytest.approx(depression)
        assert math.remainder(math.atan2(away[1], away[0]) - bearing, math.tau) == pytest.approx(
            0.0, abs=1e-9
        )
        roll = math.asin(world[2, 1] / math.hypot(world[2, 1], world[2, 2]))
        assert roll == pytest.approx(math.radians(15.0) * again.standard_normal(), abs=1e-9)


def test_poses_keep_clear_and_the_body_is_seen() -> None:
    views = _views(_ball(), clearance_m=1.5)
    for k in range(20):
        view = views.shot(k)
        place = world_from_sonar(_pose(view), views.geometry.mount)[:3, 3]
        assert np.linalg.norm(place - [2.0, -1.0, -18.0]) >= 1.0 + 1.5 - 0.05
        seabed = views.scene.seabed
        assert seabed is not None
        assert place[2] - seabed.height_at(place[:1], place[1:2])[0] >= 1.5 - 0.1
        assert place[2] < 0.0
        assert view.truth is not None
        assert (view.truth.label == 0).any()


def _pose(shot: Shot) -> Pose:
    assert shot.posed.pose is not None
    return shot.posed.pose


def test_points_are_drawn_by_area() -> None:
    """Of a box, each side as often as it is large."""
    box = trimesh.creation.box((4.0, 2.0, 1.0))
    views = _views(Scene((Body("box", box),)))
    rng = np.random.default_rng(5)
    points = np.array([views._aim(rng) for _ in range(6000)])
    half = np.array([2.0, 1.0, 0.5])
    on = np.isclose(np.abs(points), half, atol=1e-9)
    assert on.any(axis=1).all()
    shares = on.mean(axis=0)
    np.testing.assert_allclose(shares, np.array([2.0, 4.0, 8.0]) / 14.0, atol=0.02)
    assert np.abs(points.mean(axis=0)).max() < 0.06


def test_views_depend_on_their_number_alone() -> None:
    scene = _ball()
    views = _views(scene)
    later, first = views.shot(7), views.shot(0)
    again = Shots(dataset_config("tank", [SONAR, {"count": 9, "poses": {}}]), scene)
    np.testing.assert_array_equal(again.shot(0).posed.ping.image, first.posed.ping.image)
    np.testing.assert_array_equal(again.shot(7).posed.ping.image, later.posed.ping.image)
    assert _pose(again.shot(7)) == _pose(later) != _pose(first)
    other = Shots(dataset_config("tank", [SONAR, {"seed": 1, "poses": {}}]), scene)
    assert other.pose(0) != _pose(first)


def test_ground_is_not_aimed_at() -> None:
    for world, labels in (
        ("grid", {"grid"}),
        ("structures", {"manifold", "wellheads", "pipelines", "boulders"}),
        ("tank", {"pillar", "ball"}),
    ):
        config = dataset_config(world, [])
        views = Shots(config, named_scene(config.world))
        assert {views.scene.labels[k] for k in views.aims} == labels
    wide = trimesh.creation.box((100.0, 100.0, 0.5))
    ball = trimesh.creation.icosphere(radius=2.0)
    scene = Scene((Body("ground", wide), Body("ball", ball)))
    assert _views(scene).aims == (1,)
    assert _views(scene, look_at=["ground"]).aims == (0,)
    assert _views(Scene((Body("ground", wide),))).aims == (0,)


@pytest.mark.parametrize(
    ("layer", "words"),
    [
        ({"count": 0}, "count"),
        ({"poses": {"standoff_min_m": 9.0, "standoff_max_m": 2.0}}, r"poses\.standoff.*9.*2"),
        ({"poses": {"depression_min_deg": 50.0}}, r"poses\.depression"),
        ({"poses": {"lookat": []}}, "lookat"),
        ({"sonar": {"preset": "micron-dst"}}, "forward-looking"),
    ],
)
def test_bad_settings_are_named(layer: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        dataset_config("tank", [layer])


def test_what_cannot_be_seen_is_said() -> None:
    with pytest.raises(ConfigError, match=r"no body 'whale'.*ball, seabed"):
        _ = _views(_ball(), look_at=["whale"]).aims
    inside = _views(_ball(), standoff_min_m=0.2, standoff_max_m=0.5)
    with pytest.raises(ConfigError, match=r"view 0: of 2000 poses none would do \(\d+ too near"):
        inside.pose(0)


def test_a_dataset_s_defaults_are_shares_of_the_reach() -> None:
    config = Dataset(world="tank")
    reach_m = config.sonar.range_max_m
    assert standoffs_m(config) == (0.25 * reach_m, 0.75 * reach_m)
