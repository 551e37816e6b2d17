from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import colormaps

from insonify.errors import MapFileError, OutputError
from insonify.io.folders import result_folder, unused_folder
from insonify.io.maps import load_map, save_map, save_point_cloud
from insonify.mapping.voxels import IN_VIEW, OBSERVED, SURFACE, VoxelMap
from insonify.types import Box

EVERYWHERE = Box((-1e3, -1e3, -1e3), (1e3, 1e3, 1e3))


def _random_map(seed: int, blocks: int = 5) -> VoxelMap:
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(0.1)
    voxels.allocate(rng.integers(-50, 50, (blocks, 3)).astype(np.int32))
    voxels.log_odds[:] = rng.normal(size=voxels.log_odds.shape)
    voxels.seen[:] = rng.choice([0, IN_VIEW, IN_VIEW | OBSERVED], voxels.seen.shape)
    voxels.log_odds[voxels.seen != (IN_VIEW | OBSERVED)] = 0.0
    return voxels


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 20))
def test_a_map_loads_back_voxel_for_voxel(
    tmp_path_factory: pytest.TempPathFactory, seed: int, blocks: int
) -> None:
    path = tmp_path_factory.mktemp("map") / "m.npz"
    voxels = _random_map(seed, blocks)
    save_map(voxels, path)
    back = load_map(path)
    assert back.voxel_m == voxels.voxel_m
    assert back.block_count == voxels.block_count
    slots = back.find(voxels.coords)
    np.testing.assert_array_equal(back.log_odds[slots], voxels.log_odds)
    np.testing.assert_array_equal(back.seen[slots], voxels.seen)


def test_the_order_of_exploration_does_not_change_the_file(tmp_path: Path) -> None:
    a, b = VoxelMap(0.1), VoxelMap(0.1)
    coords = np.array([[0, 0, 0], [5, -1, 2], [1, 1, 1]], np.int32)
    for voxels, order in ((a, [0, 1, 2]), (b, [2, 0, 1])):
        slots = voxels.allocate(coords[order])
        voxels.log_odds[slots] = np.array(order, np.float32)[:, None] + 1.0
        save_map(voxels, tmp_path / f"{order[0]}.npz")
    assert (tmp_path / "0.npz").read_bytes() == (tmp_path / "2.npz").read_bytes()


def test_point_cloud_reads_in_another_library(tmp_path: Path) -> None:
    voxels = _random_map(1)
    save_point_cloud(voxels, tmp_path / "m.ply", 0.99, EVERYWHERE)
    cloud = trimesh.load(tmp_path / "m.ply")
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    kept = (voxels.seen > 0) & ((voxels.log_odds > 0) | (np.abs(voxels.log_odds) < 0.23))
    assert abs(len(raw) - kept.sum()) < 0.01 * kept.sum()
    names = ("x", "y", "z", "probability", "entropy", "surface", "red", "green", "blue")
    assert raw.dtype.names == names
    shade = colormaps["viridis"](np.clip(2.0 * raw["probability"] - 1.0, 0.0, 1.0), bytes=True)
    assert isinstance(cloud, trimesh.PointCloud)
    colours = np.asarray(cloud.colors).astype(int)
    assert np.abs(colours - shade).max() <= 6
    assert len(np.unique(colours, axis=0)) > 100
    p = raw["probability"].astype(float)
    expected = -(p * np.log2(p) + (1 - p) * np.log2(1 - p))
    np.testing.assert_allclose(raw["entropy"], expected, atol=1e-5)
    assert ((p > 0.5) | (raw["entropy"] >= 0.99)).all()
    np.testing.assert_array_equal(raw["surface"], p > 0.5)  # the map tells no difference


def test_a_map_that_tells_surface_from_solid_tells_it_in_files_too(tmp_path: Path) -> None:
    voxels = _random_map(1)
    marked = np.random.default_rng(4).random(voxels.seen.shape) < 0.01
    voxels.seen[marked] |= SURFACE
    assert np.array_equal(voxels.surface, marked)
    save_map(voxels, tmp_path / "m.npz")
    assert load_map(tmp_path / "m.npz").surface.sum() == marked.sum()
    save_point_cloud(voxels, tmp_path / "m.ply", 1.0, EVERYWHERE)
    raw = trimesh.load(tmp_path / "m.ply").metadata["_ply_raw"]["vertex"]["data"]
    assert raw["surface"].sum() == (marked & (voxels.seen > 0)).sum()


def test_damaged_maps_are_named(tmp_path: Path) -> None:
    good = tmp_path / "good.npz"
    save_map(_random_map(2), good)
    content = good.read_bytes()
    bad = tmp_path / "bad.npz"
    with pytest.raises(MapFileError, match="no such map file"):
        load_map(bad)
    rng = np.random.default_rng(0)
    versions = [b"", b"junk", content[: len(content) // 2]]
    for _ in range(60):
        flipped = bytearray(content)
        flipped[rng.integers(len(flipped))] ^= 1 << int(rng.integers(8))
        versions.append(bytes(flipped))
    for version in versions:
        bad.write_bytes(version)
        try:
            load_map(bad)
        except MapFileError as err:
            assert str(bad) in str(err) and "\n" not in str(err)
    bad.write_bytes(b"junk")
    with pytest.raises(MapFileError, match="damaged"):
        load_map(bad)
    np.savez(bad, format="other", version=1)
    with pytest.raises(MapFileError, match="version 1"):
        load_map(bad)


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    with pytest.raises(RuntimeError), result_folder(target) as place:
        (place.scratch / "half").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with result_folder(target) as place:
        assert not target.exists()
        (place.scratch / "a").write_text("1")
    assert [p.name for p in target.iterdir()] == ["a"]
    assert list((tmp_path / "deep").iterdir()) == [target]


def test_existing_results_are_safe_without_force_and_merged_with_it(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "mine").write_text("precious")
    (target / "a").write_text("old")
    with pytest.raises(OutputError, match="--force"), result_folder(target):
        pass
    with result_folder(target, force=True) as place:
        (place.scratch / "a").write_text("new")
    assert (target / "mine").read_text() == "precious"
    assert (target / "a").read_text() == "new"
    (target / "b").mkdir()
    with (
        pytest.raises(OutputError, match="b is a folder"),
        result_folder(target, force=True) as place,
    ):
        (place.scratch / "a").write_text("newer")
        (place.scratch / "b").write_text("newer")
    assert (target / "a").read_text() == "new", "half of the results were replaced"
    (target / "b" / "of before").write_text("old")
    with result_folder(target, force=True) as place:
        (place.scratch / "b").mkdir()
        (place.scratch / "b" / "of now").write_text("new")
    assert [path.name for path in (target / "b").iterdir()] == ["of now"]
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="not a folder"), result_folder(tmp_path / "file"):
        pass


def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with pytest.raises(OutputError, match="no space left"), result_folder(target) as place:
        (place.scratch / "a").write_text("1")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_known_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(OutputError, match="cannot be written"),
        result_folder(tmp_path / "file" / "out"),
    ):
        pytest.fail("work was done for nothing")


def test_two_runs_into_one_folder_keep_both_results(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with result_folder(target) as mine:
        (mine.scratch / "a").write_text("mine")
        with result_folder(target) as other:
            (other.scratch / "a").write_text("other")
    assert (target / "a").read_text() == "other"
    assert (mine.target, (tmp_path / "out-2/a").read_text()) == (tmp_path / "out-2", "mine")


def test_a_map_that_makes_no_sense_is_refused(tmp_path: Path) -> None:
    save_map(_random_map(2), tmp_path / "good.npz")
    good = dict(np.load(tmp_path / "good.npz"))
    twice = np.repeat(good["coords"][:1], len(good["coords"]), axis=0)
    for change in (
        {"coords": twice},
        {"coords": good["coords"].astype(float)},
        {"coords": good["coords"] + 2_000_000},
        {"log_odds": good["log_odds"].astype(str)},
        {"log_odds": good["log_odds"] * np.float32(1e9)},
        {"seen": good["seen"] + 8},
        {"coords": np.int32(3)},
    ):
        np.savez(tmp_path / "bad.npz", **(good | change))
        with pytest.raises(MapFileError, match="damaged"):
            load_map(tmp_path / "bad.npz")


def test_unused_folder_counts_up(tmp_path: Path) -> None:
    wanted = tmp_path / "run"
    assert unused_folder(wanted) == wanted
    wanted.mkdir()
    (tmp_path / "run-2").mkdir()
    assert unused_folder(wanted) == tmp_path / "run-3"
