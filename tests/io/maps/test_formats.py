"""What comes back from each format that can be read, and what damage does."""

from __future__ import annotations

import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from insonify.errors import MapFileError, MissingExtraError, OutputError
from insonify.io.datum import Datum
from insonify.io.maps import LOADED, SAVED, load_map, save_map
from insonify.io.maps.blocks import cropped
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.types import Array, Box

MakeMap = Callable[..., VoxelMap]


def _at(voxels: VoxelMap, coords: Array) -> tuple[Array, Array]:
    """Log-odds and seen bits of some blocks, 0 where a map has no such block."""
    slots = voxels.find(coords)
    there = (slots >= 0)[:, None]
    if not voxels.block_count:
        return np.zeros((len(coords), 512)), np.zeros((len(coords), 512))
    return np.where(there, voxels.log_odds[slots], 0), np.where(there, voxels.seen[slots], 0)


@pytest.mark.parametrize("suffix", LOADED)
@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 20),
    st.sampled_from([1, 3, 40, 4000]),
    st.sampled_from([0.1, 0.25, 1 / 3, 7.0]),
)
def test_maps_come_back(
    tmp_path_factory: pytest.TempPathFactory,
    make_map: MakeMap,
    suffix: str,
    seed: int,
    blocks: int,
    reach: int,
    voxel_m: float,
) -> None:
    voxels = make_map(seed, blocks, reach, voxel_m)
    path = tmp_path_factory.mktemp("map") / f"m{suffix}"
    save_map(voxels, path)
    back = load_map(path)
    assert back.voxel_m == voxel_m
    log_odds, seen = _at(back, voxels.coords)
    observed = voxels.seen == (IN_VIEW | OBSERVED)
    if suffix in (".npz", ".zarr"):
        assert back.block_count == voxels.block_count
        np.testing.assert_array_equal(seen, voxels.seen)
    else:
        np.testing.assert_array_equal(seen, np.where(observed, IN_VIEW | OBSERVED, 0))
        assert (back.seen > 0).sum() == observed.sum()
    if suffix == ".bt":
        clamped = np.where(voxels.log_odds > 0, np.float32(3.5), np.float32(-2.0))
        np.testing.assert_array_equal(log_odds, np.where(observed, clamped, 0))
    else:
        np.testing.assert_array_equal(log_odds, voxels.log_odds)


@pytest.mark.parametrize("suffix", SAVED)
def test_the_same_map_gives_the_same_bytes(suffix: str, tmp_path: Path, make_map: MakeMap) -> None:
    voxels = make_map(3)
    again = VoxelMap(voxels.voxel_m)
    slots = again.allocate(voxels.coords[::-1])
    again.log_odds[slots], again.seen[slots] = voxels.log_odds[::-1], voxels.seen[::-1]
    contents = []
    for name, each in (("a", voxels), ("b", again)):
        path = tmp_path / name / f"m{suffix}"
        path.parent.mkdir()
        save_map(each, path)
        files = sorted(p for p in path.parent.rglob("*") if p.is_file())
        contents.append([(p.name, p.read_bytes()) for p in files])
    assert contents[0] == contents[1]


@pytest.mark.parametrize("suffix", LOADED)
def test_a_region_is_the_blocks_that_it_touches(
    suffix: str, tmp_path: Path, make_map: MakeMap
) -> None:
    voxels = make_map(4, blocks=60, reach=4)
    save_map(voxels, tmp_path / f"m{suffix}")
    part = load_map(tmp_path / f"m{suffix}", Box((-0.5, -0.5, -0.5), (0.9, 2.0, 0.1)))
    whole = load_map(tmp_path / f"m{suffix}")
    wanted = np.all((whole.coords >= (-1, -1, -1)) & (whole.coords <= (1, 2, 0)), axis=1)
    assert 0 < wanted.sum() < len(wanted)
    assert sorted(map(tuple, part.coords.tolist())) == sorted(
        map(tuple, whole.coords[wanted].tolist())
    )
    np.testing.assert_array_equal(_at(part, part.coords)[0], _at(whole, part.coords)[0])


def test_a_region_of_a_zarr_reads_no_other_chunk(tmp_path: Path) -> None:
    voxels = VoxelMap(0.1)
    grid = np.stack(np.meshgrid(*[np.arange(16)] * 3), axis=-1).reshape(-1, 3)
    voxels.allocate(grid.astype(np.int32))
    voxels.log_odds[:] = np.arange(len(grid))[:, None] / len(grid)
    voxels.seen[:] = IN_VIEW | OBSERVED
    save_map(voxels, tmp_path / "m.zarr")
    corner = Box((0.01, 0.01, 0.01), (3.0, 3.0, 3.0))
    before = load_map(tmp_path / "m.zarr", corner)
    removed = 0
    for name in ("log_odds", "seen"):
        chunks = tmp_path / "m.zarr" / name / "c"
        for chunk in [path for path in chunks.rglob("*") if path.is_file()]:
            if chunk != chunks / "0" / "0" / "0":
                chunk.unlink()
                removed += 1
    assert removed == 2 * 7
    after = load_map(tmp_path / "m.zarr", corner)
    assert after.block_count == 64
    np.testing.assert_array_equal(after.log_odds, before.log_odds)
    with pytest.raises(MapFileError, match="is missing"):
        load_map(tmp_path / "m.zarr")


def test_a_zarr_of_version_2_is_still_read(tmp_path: Path, make_map: MakeMap) -> None:
    zarr = pytest.importorskip("zarr")
    voxels = make_map(4, blocks=60, reach=4)
    about = {"format": "insonify-map", "version": 2, "voxel_m": voxels.voxel_m}
    group = zarr.create_group(tmp_path / "m.zarr", zarr_format=3, attributes=about)
    for name, rows in (("coords", 4096), ("log_odds", 256), ("seen", 256)):
        told = getattr(voxels, name)
        array = group.create_array(
            name, shape=told.shape, chunks=(rows, told.shape[1]), dtype=told.dtype
        )
        array[:] = told
    for region in (None, Box((-0.5, -0.5, -0.5), (0.9, 2.0, 0.1))):
        back = load_map(tmp_path / "m.zarr", region)
        wanted = voxels if region is None else cropped(voxels, region)
        np.testing.assert_array_equal(back.coords, wanted.coords)
        np.testing.assert_array_equal(back.log_odds, wanted.log_odds)
        np.testing.assert_array_equal(back.seen, wanted.seen)
    with pytest.raises(MapFileError, match="version 2"):
        load_map(tmp_path / "m.zarr", memory_bytes=10**9)


def _mutated(content: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(content)
    kind = rng.integers(5)
    place = int(rng.integers(max(1, len(data))))
    if kind == 0:
        return bytes(data[:place])
    if kind == 1:
        return bytes(data[:place]) + rng.bytes(int(rng.integers(1, 40))) + bytes(data[place:])
    for _ in range(1 if kind == 2 else 8):
        place = int(rng.integers(min(len(data), 300 if kind == 3 else len(data))))
        data[place] ^= 1 << int(rng.integers(8))
    return bytes(data)


@pytest.mark.parametrize("suffix", LOADED)
def test_damaged_files_are_named_and_take_little_memory(
    suffix: str,
    tmp_path: Path,
    make_map: MakeMap,
) -> None:
    good, bad = tmp_path / f"good{suffix}", tmp_path / f"bad{suffix}"
    save_map(make_map(5), good)
    load_map(good)
    rng = np.random.default_rng(6)
    refused = 0
    rounds = 60 if suffix == ".zarr" else 250
    tracemalloc.start()
    for _ in range(rounds):
        if good.is_dir():
            shutil.rmtree(bad, ignore_errors=True)
            shutil.copytree(good, bad)
            victim = rng.choice(sorted(p for p in bad.rglob("*") if p.is_file()))
            victim.write_bytes(_mutated(victim.read_bytes(), rng))
        else:
            bad.write_bytes(_mutated(good.read_bytes(), rng))
        try:
            load_map(bad)
        except MapFileError as err:
            refused += 1
            assert str(bad) in str(err) and "\n" not in str(err)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert refused > rounds / 3
    assert peak < 100e6


def test_trees_that_announce_too_much_are_refused_before_they_are_read(tmp_path: Path) -> None:
    head = b"# Octomap OcTree file\nid OcTree\nsize %d\nres %s\ndata\n"
    whole_world = b"\0\0\x80\x3f\0"
    for size, resolution, data, words in (
        (1, b"0.1", whole_world, "unfold"),
        (10**15, b"0.1", whole_world, "cannot hold"),
        (1, b"nan", whole_world, "makes no sense"),
        (1, b"-1", whole_world, "makes no sense"),
        (2, b"0.1", b"\0\0\x80\x3f\1" * 2, "are not the 2"),
        (18, b"0.1", b"\0\0\x80\x3f\1" * 18, "deeper than 16"),
        (1, b"0.1", b"\0\0\xc0\x7f\0", "log-odds"),
    ):
        (tmp_path / "m.ot").write_bytes(head % (size, resolution) + data)
        with pytest.raises(MapFileError, match=words):
            load_map(tmp_path / "m.ot")
    (tmp_path / "m.ot").write_bytes((head % (1, b"1")).replace(b"OcTree\ns", b"ColorOcTree\ns"))
    with pytest.raises(MapFileError, match="only OcTree"):
        load_map(tmp_path / "m.ot")


def test_what_cannot_be_written_or_read_is_said(
    tmp_path: Path,
    make_map: MakeMap,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    voxels = make_map(1)
    with pytest.raises(OutputError, match=r"'\.pcd'"):
        save_map(voxels, tmp_path / "m.pcd")
    with pytest.raises(OutputError, match="GeoTIFF"):
        save_map(voxels, tmp_path / "m.ply", datum=Datum(1.0, 2.0))
    for suffix in (".glb", ".stl", ".tif", ".xyz"):
        with pytest.raises(OutputError, match="no occupied voxel"):
            save_map(VoxelMap(0.1), tmp_path / f"m{suffix}")
    far = make_map(1, reach=100_000)
    with pytest.raises(OutputError, match="OctoMap holds"):
        save_map(far, tmp_path / "m.bt")
    with pytest.raises(MapFileError, match=r"\.ply cannot be read back"):
        save_map(voxels, tmp_path / "m.ply")
        load_map(tmp_path / "m.ply")
    with pytest.raises(MapFileError, match=r"no map\.npz"):
        load_map(tmp_path)
    with pytest.raises(MapFileError, match="no such map"):
        load_map(tmp_path / "none.zarr")
    (tmp_path / "empty.zarr").mkdir()
    with pytest.raises(MapFileError, match="damaged"):
        load_map(tmp_path / "empty.zarr")
    monkeypatch.setitem(__import__("sys").modules, "zarr", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'insonify\[maps\]'"):
        save_map(voxels, tmp_path / "m.zarr")


def test_a_result_folder_stands_for_its_map(tmp_path: Path, make_map: MakeMap) -> None:
    voxels = make_map(2)
    save_map(voxels, tmp_path / "map.npz")
    np.testing.assert_array_equal(_at(load_map(tmp_path), voxels.coords)[0], voxels.log_odds)
