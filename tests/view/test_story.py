"""Stories: the same pings, decisions and maps as the run or recording they tell of."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import InsonifyError
from insonify.io.maps import load_map, save_map
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.recording import Reading
from insonify.mapping.mapper import MappingSettings
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.planning.decision import Decision
from insonify.results.map import MapConfig
from insonify.types import FanGeometry, Ping, Pose, PosedPing
from insonify.view import shapes
from insonify.view.cubes import occupied_cubes
from insonify.view.sources import open_story
from insonify.view.story import Story, Thinned

pytestmark = pytest.mark.slow

SMALL = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 8}}
HOW = MapConfig(mapping=MappingSettings(voxel_m=0.25))


def _scan(folder: Path, *more: str) -> Path:
    sets = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=8"]
    done = CliRunner().invoke(app, ["scan", "tetrapod", *sets, *more, "--out", str(folder)])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _scan(tmp_path_factory.mktemp("story") / "run")


@pytest.fixture(scope="module")
def run() -> tuple[Run, Story]:
    story = Story("live")
    return execute(scenario_config("tetrapod", [SMALL]), watch=story.watch), story


@given(st.integers(1, 40), st.integers(1, 5), st.integers(1, 60))
def test_thinned_keeps_every_nth_and_the_last(count: int, size: int, limit: int) -> None:
    kept: Thinned[int] = Thinned(most_bytes=limit)
    for number in range(1, count + 1):
        kept.add(number, 10 * number, size)
    assert kept.stride & (kept.stride - 1) == 0
    numbers = range(1, count + 1, kept.stride)
    assert len(numbers) == 1 or len(numbers) * size <= limit
    assert kept.stride == 1 or len(range(1, count + 1, kept.stride // 2)) * size > limit
    for number in range(1, count + 1):
        nearest = count if number == count else (number - 1) // kept.stride * kept.stride + 1
        assert kept.at(number) == (nearest, 10 * nearest)
    assert kept.at(0) is None


def _story(*given: Any) -> Story:
    """A story told to its end."""
    told = open_story(*given)
    told.go_on(lambda done, count: None, lambda: False)
    return told.story


def test_a_story_told_live_is_the_run(run: tuple[Run, Story]) -> None:
    done, story = run
    assert len(story.moments) == done.pings
    flown = [pose for path in done.paths for pose in path.waypoints]
    assert [moment.pose for moment in story.moments] == flown
    assert story.end == done.result().why_stopped
    assert {solid.name for solid in story.world} == set(done.world.scene.labels)
    found = story.maps.at(len(story.moments))
    assert found is not None and found[0] == done.pings
    there, _ = occupied_cubes(done.mapper.voxels, done.world.area.region)
    np.testing.assert_array_equal(found[1].occupied.index, there.index)
    assert there.count == done.mapper.voxels.window(done.world.area.region).occupied.sum()


def test_a_run_s_folder_tells_the_same_story(run_folder: Path, run: tuple[Run, Story]) -> None:
    live, told = run[1], _story(run_folder, Reading(), HOW)
    assert [m.pose for m in told.moments] == [m.pose for m in live.moments]
    assert [m.scan for m in told.moments] == [m.scan for m in live.moments]
    assert told.end == live.end
    for number in range(1, len(live.moments) + 1):
        for kept in ("images", "maps"):
            ours, theirs = getattr(told, kept).at(number), getattr(live, kept).at(number)
            assert ours[0] == theirs[0] == number
        np.testing.assert_array_equal(told.images.at(number)[1], live.images.at(number)[1])  # type: ignore[index]
    _same_decisions(told.decisions, live.decisions)


def _same_decisions(ours: list[tuple[int, Decision]], theirs: list[tuple[int, Decision]]) -> None:
    assert len(ours) == len(theirs) > 1
    for (after, mine), (when, other) in zip(ours, theirs, strict=True):
        assert after == when
        assert mine.path == other.path and mine.stop == other.stop
        if other.look is not None:
            assert mine.look is not None
            np.testing.assert_array_equal(mine.look.h_sum, other.look.h_sum)


def test_a_run_that_was_broken_off_ends_where_it_was(run_folder: Path, tmp_path: Path) -> None:
    from insonify.io.recordings.ros.mcap_writing import McapWriter
    from insonify.results.recorder import ScanRecorder

    count = 11
    shutil.copy(run_folder / "config.toml", tmp_path)
    with McapWriter(tmp_path / "recording.mcap") as writer:
        recorder = ScanRecorder(writer)
        done = execute(
            scenario_config("tetrapod", [SMALL]),
            watch=recorder.watch,
            should_stop=iter([False] * (count - 1) + [True]).__next__,
        )
    assert done.pings == count
    story = _story(tmp_path, Reading(), HOW)
    assert len(story.moments) == count
    found = story.maps.at(count)
    assert found is not None and found[0] == count
    there, _ = occupied_cubes(done.mapper.voxels, done.mapper.voxels.around_occupied())
    np.testing.assert_array_equal(found[1].occupied.index, there.index)


def test_a_vehicle_s_story_knows_where_it_really_was(tmp_path: Path) -> None:
    folder = _scan(
        tmp_path / "run", "--vehicle", "bluerov2", "--navigation", "dvl", "--planner", "uniform",
        "--set", "survey.baseline_scans=2",
    )  # fmt: skip
    story = _story(folder, Reading(), HOW)
    off = [
        math.dist(m.pose.position_m, m.true_pose.position_m)
        for m in story.moments
        if m.pose is not None and m.true_pose is not None
    ]
    assert len(off) == len(story.moments) > 8
    assert 0.0 < max(off) < 1.0


def test_recordings_and_maps(run_folder: Path, tmp_path: Path) -> None:
    recorded = _story(run_folder / "recording.mcap", Reading(), HOW)
    voxels = load_map(run_folder)
    found = recorded.maps.at(len(recorded.moments))
    assert found is not None
    assert found[1].occupied.count + found[1].elsewhere.count == (voxels.log_odds > 0).sum()
    assert recorded.decisions == [] and recorded.world == ()
    for name in ("m.npz", "m.bt", "m.zarr"):
        save_map(voxels, tmp_path / name)
        alone = _story(tmp_path / name, Reading(), HOW)
        picture = alone.maps.at(0)
        assert alone.moments == [] and picture is not None
        assert picture[1].occupied.count == (voxels.log_odds > 0).sum()


def test_a_recording_without_poses_is_its_images(tmp_path: Path) -> None:
    fan = FanGeometry(1.0, 0.2, 6, 8, 0.1, 2.0)
    rng = np.random.default_rng(1)
    pings = [Ping(rng.random((8, 6), np.float32), fan, float(k)) for k in range(3)]
    save_arrays(tmp_path / "r.npz", [PosedPing(ping) for ping in pings])
    story = _story(tmp_path / "r.npz", Reading(), HOW)
    assert [m.pose for m in story.moments] == [None] * 3
    image = story.images.at(2)
    assert image is not None
    np.testing.assert_allclose(image[1] / 255.0, pings[1].image, atol=0.5 / 255 + 1e-6)
    assert story.maps.at(3) is None


def test_what_cannot_be_shown_is_said(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InsonifyError, match="no such recording"):
        _story(tmp_path / "none", Reading(), HOW)
    shutil.copytree(run_folder, tmp_path / "cut")
    (tmp_path / "cut/recording.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(InsonifyError, match=r"recording\.mcap: damaged or cut off"):
        _story(tmp_path / "cut", Reading(), HOW)


def test_the_edges_of_a_fan_lie_on_its_limits() -> None:
    fan = FanGeometry(math.radians(60.0), math.radians(20.0), 8, 8, 1.5, 9.0)
    ends = shapes.fan_edges(fan).reshape(-1, 3).astype(np.float64)
    range_m = np.linalg.norm(ends, axis=1)
    azimuth = np.degrees(np.arctan2(ends[:, 1], ends[:, 0]))
    elevation = np.degrees(np.arcsin(ends[:, 2] / range_m))
    assert (np.isclose(range_m, 1.5, atol=1e-5) | np.isclose(range_m, 9.0, atol=1e-5)).all()
    assert np.abs(azimuth).max() == pytest.approx(30.0, abs=1e-4)
    assert np.abs(elevation).max() == pytest.approx(10.0, abs=1e-4)


def test_the_overview_sees_all_of_a_box() -> None:
    low, high = np.array([-3.0, 2.0, -20.0]), np.array([9.0, 5.0, -12.0])
    camera, target = shapes.overview(low, high)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    ahead = (target - camera) / np.linalg.norm(target - camera)
    rays = (corners - camera) / np.linalg.norm(corners - camera, axis=1)[:, None]
    assert camera[2] > high[2]
    assert np.degrees(np.arccos(rays @ ahead)).max() < 75 / 2  # the browser's field of view


def test_pointers_point_along_the_yaw() -> None:
    lines = shapes.pointers([Pose(1.0, 2.0, 3.0, yaw_rad=math.pi / 2)], 2.0)
    np.testing.assert_allclose(lines, [[[1, 2, 3], [1, 4, 3]]], atol=1e-6)


def test_a_picture_s_top_is_far_and_silence_is_clear() -> None:
    fan = FanGeometry(math.radians(60.0), 0.2, 30, 40, 0.0, 10.0)
    image = np.zeros((40, 30), np.float32)
    image[30:, :8] = 1.0  # far, to port
    picture, extent = shapes.fan_picture(Ping(image, fan), 200)
    rows, columns = np.nonzero(picture[..., 3] == 255)
    assert rows.max() < picture.shape[0] / 2 and columns.max() < 100
    assert picture[-1, 0, 3] == 0
    assert 0 < picture[picture.shape[0] // 2, 100, 3] < 255
    assert extent[3] == 10.0
