"""Several sonars on one vehicle: clocks, mounts and heads of their own."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insonify.config.toml import config_to_toml
from insonify.errors import ConfigError
from insonify.frames import compose
from insonify.imaging.tour import Tour, TourPing, tour, tour_config, turns_of
from insonify.io.recordings import open_recording
from insonify.results.tour import COLUMNS
from insonify.scene import Scene
from insonify.scene.named import named_scene
from insonify.sonar.scanning import head_angles, head_at
from insonify.types import Pose, StopReason
from insonify.vehicle.craft import Craft

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
SMALL = {"range_max_m": 8.0, "bins": 40}
SONARS = [
    {
        "name": "fls",
        "x_m": 0.3,
        "rate_hz": 2.0,
        "sonar": {"preset": "park-2025", "tilt_deg": 20.0, "beams": 8, **SMALL},
    },
    {
        "name": "msis",
        "z_m": 0.2,
        "yaw_deg": 90.0,
        "rate_hz": 10.0,
        "sonar": {"preset": "micron-dst", "step_deg": 18.0, **SMALL},
    },
]
ROUTE = [[-3.0, 0.0, -2.0, 0.0], [-2.0, 0.0, -2.0, 20.0]]
COARSE = {"across_beam": 2, "over_elevation": 16}


def _config(**more: Any) -> Tour:
    layer = {"world": "tank", "waypoints": ROUTE, "sonars": SONARS, "sampling": COARSE}
    return tour_config([layer, more])


@pytest.fixture(scope="module")
def tank() -> Scene:
    return named_scene("tank")


@pytest.fixture(scope="module")
def flown(tank: Scene) -> list[TourPing | Craft | StopReason]:
    return list(tour(_config(), tank))


def _true(one: TourPing) -> Pose:
    assert one.posed.true_pose is not None
    return one.posed.true_pose


def _of(flown: list[TourPing | Craft | StopReason], name: str) -> list[TourPing]:
    return [one for one in flown if isinstance(one, TourPing) and one.sonar == name]


def test_each_sonar_keeps_its_own_clock(flown: list[TourPing | Craft | StopReason]) -> None:
    assert isinstance(flown[0], Craft) and flown[-1] is StopReason.PLAN_FLOWN
    for name, rate_hz in (("fls", 2.0), ("msis", 10.0)):
        times = [one.posed.ping.time_s for one in _of(flown, name)]
        assert len(times) == pytest.approx(flown[0].time_s * rate_hz, abs=1)
        assert np.diff(times)[1:] == pytest.approx(1.0 / rate_hz, abs=1e-9)


def test_heads_turn_step_by_step_and_the_mount_is_the_whole_way_from_the_body(
    flown: list[TourPing | Craft | StopReason],
) -> None:
    config = _config()
    msis = _of(flown, "msis")
    angles = head_angles(config.sonars[1].sonar)
    assert len(angles) == 20
    for one in msis[:45]:
        assert one.posed.ping.head_rad == angles[one.number % 20]
        mount = one.posed.ping.geometry.mount
        assert mount.position_m == pytest.approx((0.0, 0.0, 0.2))
        turned = math.remainder(mount.yaw_rad - math.pi / 2 - one.posed.ping.head_rad, math.tau)
        assert turned == pytest.approx(0.0, abs=1e-9)
    fls = _of(flown, "fls")[0].posed.ping.geometry.mount
    assert (fls.x_m, math.degrees(fls.pitch_rad)) == pytest.approx((0.3, 20.0))
    turns = list(turns_of(msis, config.sonars[1]))
    assert len(turns) == len(msis) // 20
    assert turns[0][3].pose == compose(_true(msis[3]), config.sonars[1].place)


def test_an_image_is_that_of_a_sonar_at_the_true_pose(
    tank: Scene, flown: list[TourPing | Craft | StopReason]
) -> None:
    """Of the head's own pose and geometry, without the vehicle in between."""
    from insonify.sonar import Sonar

    config = _config()
    one = _of(flown, "msis")[7]
    sonar = Sonar(config.sonars[1].sonar, config.sampling, config.image)
    base = compose(_true(one), Pose(0.0, 0.0, 0.2, yaw_rad=math.pi / 2))
    alone = sonar.ping(tank, base, np.random.default_rng(5), head_rad=one.posed.ping.head_rad)
    # alike but for their noise
    assert np.corrcoef(alone.image.ravel(), one.posed.ping.image.ravel())[0, 1] > 0.9


def test_a_tour_into_the_wall_ends_there_and_a_silent_sonar_gives_nothing(tank: Scene) -> None:
    into = list(tour(_config(waypoints=[ROUTE[0], [9.0, 0.0, -2.0, 0.0]]), tank))
    assert into[-1] is StopReason.COLLISION
    fault = {"sensor": "sonar", "at_s": 1.0}
    silent = list(tour(_config(vehicle={"fault": fault}), tank))
    assert silent[-1] is StopReason.PLAN_FLOWN
    assert max(one.posed.ping.time_s for one in silent if isinstance(one, TourPing)) <= 1.0


def test_heads_that_go_back_and_forth() -> None:
    device = _config().sonars[1].sonar.model_copy(update={"back_and_forth": True})
    assert len(head_angles(device)) == 20
    there = [head_at(device, k) for k in range(40)]
    assert there[20:] == there[:20][::-1]


def test_the_saved_settings_give_the_same_tour(tmp_path: Path) -> None:
    from insonify.config.layers import read_layer

    config = _config(vehicle={"current": {"velocity_m_s": [0.1, 0.0, 0.0]}})
    path = tmp_path / "config.toml"
    path.write_text(config_to_toml(config, "fly"))
    assert tour_config([read_layer(path)]) == config


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"sonars": "nonesuch"}, "no set of sonars named 'nonesuch'"),
        ({"sonars": "none.toml"}, "no such file of sonars"),
        ({"sonars": []}, "sonars"),
        ({"sonars": [SONARS[0], SONARS[0]]}, "same name"),
        ({"sonars": [SONARS[0] | {"rate_hz": 0}]}, "rate_hz"),
        ({"sonars": [SONARS[0] | {"sonar": {"preset": "asdic"}}]}, "asdic"),
        ({"vehicle": {"name": "submarine"}}, "submarine"),
        ({"waypoints": [ROUTE[0]]}, "waypoints"),
        ({"waypoints": [ROUTE[0], [0.0, math.nan, 0.0, 0.0]]}, "finite"),
    ],
)
def test_what_cannot_be_flown_is_refused(more: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        _config(**more)


def test_a_tour_needs_a_world_and_waypoints() -> None:
    with pytest.raises(ConfigError, match="name a world"):
        tour_config([{"waypoints": ROUTE}])
    with pytest.raises(ConfigError, match="--waypoints"):
        tour_config([{"world": "tank"}])


def test_the_command_writes_images_and_the_true_pose_of_each_ping(tmp_path: Path) -> None:
    (tmp_path / "sonars.toml").write_text(
        '[[sonars]]\nname = "fls"\nrate_hz = 2\n'
        '[sonars.sonar]\npreset = "park-2025"\nbeams = 8\nbins = 40\n'
    )
    done = subprocess.run(
        [
            sys.executable, "-m", "insonify", "fly", "tank", "--waypoints", "-3 0 -2; -2.5 0 -2",
            "--sonars", "sonars.toml", "--out", "out", "--json", "--mcap",
        ],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    with (tmp_path / "out/pings.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS and len(rows) == result["pings"]["fls"]
    with np.load(tmp_path / "out/fls.npz") as archive:
        assert archive["images"].shape == (len(rows), 40, 8)
        assert archive["true_pose"][-1, 0] == pytest.approx(float(rows[-1]["true_x_m"]))
    assert (tmp_path / "out/trajectory.csv").is_file()
    recording = open_recording(tmp_path / "out/fls.npz")
    heard = list(recording)
    assert recording.exact and recording.format == "result of fly" and len(heard) == len(rows)
    for row, one in zip(rows, heard, strict=True):
        assert one.true_pose is not None and one.pose is not None
        assert one.true_pose.x_m == pytest.approx(float(row["true_x_m"]))
        assert one.pose.x_m == pytest.approx(float(row["estimated_x_m"]))
        assert one.ping.time_s == pytest.approx(float(row["time_s"]))
    assert heard[0].ping.geometry.bins == 40 and heard[0].ping.geometry.beams == 8
    for one, again in zip(heard, open_recording(tmp_path / "out/pings.mcap"), strict=True):
        np.testing.assert_array_equal(one.ping.image, again.ping.image)
        assert one.ping.geometry == again.ping.geometry
        assert one.pose == again.pose and one.true_pose == again.true_pose


def test_flatfish_over_the_sunken_ship() -> None:
    world = DATA / "worlds/sunken_ship_site.world"
    if not world.is_file():
        pytest.skip("needs ../shared/data, which is not here")
    config = tour_config([{"world": str(world), "waypoints": [[-4, -2, -50, 0], [-3, -2, -50, 0]]}])
    with pytest.warns(UserWarning, match="normal map"):
        scene = named_scene(config.world)
    heard = [one for one in tour(config, scene) if isinstance(one, TourPing)]
    assert {one.sonar for one in heard} == {"fls", "msis-top", "msis-back"}
    down = [one for one in heard if one.sonar == "msis-back" and abs(one.posed.ping.head_rad) < 0.2]
    ranges = [
        one.posed.ping.geometry.bin_ranges_m[one.posed.ping.image[:, 0].argmax()] for one in down
    ]
    assert np.median(ranges) < 10.5  # the seabed is 10 m below, the wreck nearer
