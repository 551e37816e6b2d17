"""Maps kept on disk: the same as in memory, whatever is asked of them, also after a kill."""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from insonify.errors import MapFileError, MemoryLimitError
from insonify.io.maps import SAVED, load_map, ondisk, save_map
from insonify.io.maps.ondisk import BYTES_PER_BLOCK, TileStore
from insonify.io.maps.tiles import TileFiles, blocks_of, places_of
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.types import Array, Box, FanGeometry, Ping, Pose

SMALL = 1200 * BYTES_PER_BLOCK
"""Of memory: little more than what is held at a time."""
BOX = Box((-4.0, -9.0, -3.0), (11.0, 6.5, 2.0))


@pytest.fixture(autouse=True)
def _little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ondisk, "LEAST_BYTES", SMALL)
    for name in ("_PICKED_BYTES", "_DENSE_BYTES"):  # what is picked would not fit there
        monkeypatch.setattr(f"insonify.mapping.voxels.{name}", 1e-9)


def _walk(rng: np.random.Generator, steps: int) -> Iterator[tuple[Array, Array, Array]]:
    """Blocks near a place that wanders, what to add to their voxels, and bits to set."""
    place = np.zeros(3)
    for _ in range(steps):
        blocks = np.unique((place + rng.normal(0.0, 3.0, (120, 3))).astype(np.int32), axis=0)
        change = rng.integers(-3, 4, (len(blocks), 512)).astype(np.float32)
        yield blocks, change, np.where(change != 0, IN_VIEW | OBSERVED, 0).astype(np.uint8)
        place += rng.normal(0.0, 8.0, 3) * (1.0, 1.0, 0.3)


def _write(voxels: VoxelMap, walk: Iterator[tuple[Array, Array, Array]]) -> None:
    for blocks, change, bits in walk:
        held = voxels.hold(blocks)
        held.log_odds[held.slots] += change
        held.seen[held.slots] |= bits


def _both(folder: Path, seed: int, steps: int = 36) -> tuple[VoxelMap, VoxelMap]:
    """The same map in memory and on disk."""
    memory = VoxelMap(0.25, origin_m=(2e4, 0.0, 0.0))
    disk = VoxelMap(0.25, TileStore.new(folder / "work.zarr", SMALL), (2e4, 0.0, 0.0))
    for voxels in (memory, disk):
        _write(voxels, _walk(np.random.default_rng(seed), steps))
    return memory, disk


def _bytes(path: Path) -> dict[str, bytes]:
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return {str(p.relative_to(path)): p.read_bytes() for p in files}


def test_places_in_tiles_and_back() -> None:
    rng = np.random.default_rng(0)
    blocks = rng.integers(-900, 900, (500, 3)).astype(np.int32)
    tiles, places = places_of(blocks)
    np.testing.assert_array_equal(tiles, np.floor(blocks / 8))
    for block, tile, place in zip(blocks, tiles, places, strict=True):
        np.testing.assert_array_equal(blocks_of(tile, np.array([place]))[0], block)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_question_has_the_same_answer(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    memory, disk = _both(tmp_path_factory.mktemp("map"), seed)
    assert memory.block_count * BYTES_PER_BLOCK > 1.5 * SMALL  # so that tiles came and went
    assert disk.block_count == memory.block_count and disk.marked == memory.marked
    assert disk.around_occupied() == memory.around_occupied()
    for box in (None, BOX):
        for order in ("any", "ascending", "tiles"):
            parts = list(disk.parts(box, order))
            coords = np.concatenate([part.coords for part in parts])
            wanted = np.concatenate([part.coords for part in memory.parts(box, order)])
            if order == "any":
                coords, wanted = (np.unique(one, axis=0) for one in (coords, wanted))
            np.testing.assert_array_equal(coords, wanted)
        ours, theirs = (
            voxels.select(lambda part: part.log_odds > 2.0, box) for voxels in (memory, disk)
        )
        order_of = [np.lexsort(some.index.T) for some in (ours, theirs)]
        np.testing.assert_array_equal(ours.index[order_of[0]], theirs.index[order_of[1]])
        np.testing.assert_array_equal(ours.seen[order_of[0]], theirs.seen[order_of[1]])
    near = memory.coords[::3] + np.int32(1)
    for name in ("log_odds", "seen"):
        ours, theirs = (getattr(voxels.read(near), name) for voxels in (memory, disk))
        np.testing.assert_array_equal(ours, theirs)
        ours, theirs = (getattr(voxels.window(BOX), name) for voxels in (memory, disk))
        np.testing.assert_array_equal(ours, theirs)
    assert disk.at((3, 4, -5)) == memory.at((3, 4, -5))


@pytest.mark.parametrize("suffix", [suffix for suffix in SAVED if suffix != ".tif"])
def test_every_format_has_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    memory, disk = _both(tmp_path, 3, steps=4)
    for name, voxels in (("memory", memory), ("disk", disk)):
        save_map(voxels, tmp_path / f"{name}{suffix}")
    assert _bytes(tmp_path / f"memory{suffix}") == _bytes(tmp_path / f"disk{suffix}")


def test_a_store_becomes_the_map_that_memory_writes(tmp_path: Path) -> None:
    memory, disk = _both(tmp_path, 5)
    save_map(memory, tmp_path / "memory.zarr")
    assert isinstance(disk.store, TileStore)
    disk.store.settle(disk.voxel_m, disk.origin_m)
    assert _bytes(tmp_path / "work.zarr") == _bytes(tmp_path / "memory.zarr")
    save_map(memory, tmp_path / "memory.npz")
    for name, limit in (("whole", None), ("lazy", SMALL)):
        back = load_map(tmp_path / "work.zarr", memory_bytes=limit)
        assert back.in_memory == (limit is None) and back.origin_m == memory.origin_m
        save_map(back, tmp_path / f"{name}.npz")
        assert (tmp_path / f"{name}.npz").read_bytes() == (tmp_path / "memory.npz").read_bytes()
    save_map(disk, tmp_path / "after.npz")  # it can still be read
    assert (tmp_path / "after.npz").read_bytes() == (tmp_path / "memory.npz").read_bytes()


def test_other_programs_read_it_as_dense_arrays_with_coordinates(tmp_path: Path) -> None:
    zarr, xarray = pytest.importorskip("zarr"), pytest.importorskip("xarray")
    memory, _ = _both(tmp_path, 6, steps=6)
    save_map(memory, tmp_path / "m.zarr")
    low, high = memory.coords.min(axis=0) * 2.0, (memory.coords.max(axis=0) + 1) * 2.0
    window = memory.window(Box.of(low, high))
    group = zarr.open_group(tmp_path / "m.zarr", mode="r")
    start = np.subtract(window.first, group.attrs["first_voxel"])
    inside = tuple(map(slice, start, start + window.log_odds.shape))
    np.testing.assert_array_equal(group["log_odds"][inside], window.log_odds)
    np.testing.assert_array_equal(group["seen"][inside], window.seen)
    told = xarray.open_zarr(tmp_path / "m.zarr", consolidated=False)
    centre = window.centres_m(window.occupied)[0] + memory.origin_m
    found = told.log_odds.sel(x=centre[0], y=centre[1], z=centre[2], method="nearest")
    assert float(abs(found.x - centre[0])) < 1e-6 and float(found) > 0.0


def test_what_only_memory_has_is_refused_and_so_is_too_little(tmp_path: Path) -> None:
    _, disk = _both(tmp_path, 7, steps=3)
    for ask in (lambda: disk.log_odds, lambda: disk.seen, lambda: disk.find(disk.coords)):
        with pytest.raises(MemoryLimitError, match="kept on disk"):
            ask()
    many = np.stack(np.meshgrid(*[np.arange(16)] * 3), axis=-1).reshape(-1, 3).astype(np.int32)
    before = disk.block_count
    with pytest.raises(MemoryLimitError, match="--memory"):
        disk.hold(many)
    assert disk.block_count == before
    with pytest.raises(MemoryLimitError, match="or more"):
        TileStore.new(tmp_path / "tiny.zarr", SMALL - 1)
    assert isinstance(disk.store, TileStore)
    disk.store.settle(disk.voxel_m, disk.origin_m)
    lazy = load_map(tmp_path / "work.zarr", memory_bytes=SMALL)
    with pytest.raises(TypeError, match="cannot be written"):
        lazy.hold(many[:2])


def test_more_than_the_limit_is_not_taken_out_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, disk = _both(tmp_path, 7, steps=8)
    monkeypatch.setattr("insonify.mapping.voxels._PICKED_BYTES", 128)
    monkeypatch.setattr("insonify.mapping.voxels._DENSE_BYTES", 24)
    most = SMALL // 128
    some = disk.select(lambda part: part.log_odds > 8.0)
    assert 0 < len(some.index) <= most < disk.count(lambda part: part.log_odds > 0.0)
    with pytest.raises(MemoryLimitError, match=r"--memory gives 3.07 MB; .*--region"):
        disk.select()
    with pytest.raises(MemoryLimitError, match="--region"):
        save_map(disk, tmp_path / "m.ot")
    box = Box((0.0, 0.0, 0.0), (12.5, 12.5, 12.5))  # 125,000 voxels
    with pytest.raises(MemoryLimitError, match=r"14.5 x 14.5 x 14.5 m in voxels of 0.25 m"):
        disk.window(box.grown(1.0))
    assert disk.window(box).log_odds.shape == (50, 50, 50)
    assert disk.overview(box.grown(1.0)).voxel_m == 2.0
    save_map(disk, tmp_path / "m.npz")
    save_map(disk, tmp_path / "m.xyz")


def test_damage_is_found_when_a_tile_is_read(tmp_path: Path) -> None:
    memory, _ = _both(tmp_path, 8, steps=8)
    save_map(memory, tmp_path / "m.zarr")
    chunk = next(p for p in (tmp_path / "m.zarr" / "log_odds" / "c").rglob("*") if p.is_file())
    content = chunk.read_bytes()
    for bad in (content[:-1], content[:9] + bytes([content[9] ^ 1]) + content[10:], None):
        chunk.unlink()
        if bad is not None:
            chunk.write_bytes(bad)
        lazy = load_map(tmp_path / "m.zarr", memory_bytes=SMALL)
        with pytest.raises(MapFileError, match="log_odds/c/"):
            lazy.count(lambda part: part.log_odds > 0)
        chunk.write_bytes(content)


class _KilledError(Exception):
    pass


def test_after_a_kill_the_files_are_those_of_a_flush(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever it comes: the state of the last flush, or of the one that was under way."""
    steps = list(_walk(np.random.default_rng(9), 16))
    states, replace = [], Path.replace
    memory = VoxelMap(0.25)
    for half in (steps[:8], steps[8:]):
        _write(memory, iter(half))
        states.append({tuple(c): v.copy() for c, v in zip(memory.coords, memory.log_odds)})  # noqa: B905
    for dies_at in (0, 1, 2, 5, 17, 10_000):
        folder = tmp_path / f"{dies_at}.zarr"
        store = TileStore.new(folder, SMALL)
        _write(VoxelMap(0.25, store), iter(steps[:8]))
        store.flush()
        _write(VoxelMap(0.25, store), iter(steps[8:]))
        calls = 0

        def dying(self: Path, target: Path, limit: int = dies_at) -> Path:
            nonlocal calls
            calls += 1
            if calls > limit:
                raise _KilledError
            return replace(self, target)

        monkeypatch.setattr(Path, "replace", dying)
        with suppress(_KilledError):
            store.flush()
        monkeypatch.setattr(Path, "replace", replace)
        files = TileFiles(folder)
        files.recover()
        committed = states[0 if dies_at == 0 else 1]
        after = TileStore(files, SMALL)
        after.recall(np.array(list(committed), np.int32), IN_VIEW | OBSERVED)
        found = after.read(np.array(list(committed), np.int32))
        np.testing.assert_array_equal(found.log_odds, np.array(list(committed.values())))
        assert not list(folder.rglob("*.new"))


def test_nobody_writes_any_more_when_an_error_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, disk = _both(tmp_path, 7, steps=3)
    write_bytes = Path.write_bytes
    calls = 0

    def full(self: Path, data: bytes) -> int:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise OSError(errno.ENOSPC, "no space left")
        time.sleep(0.05)
        return write_bytes(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert isinstance(disk.store, TileStore)
    with pytest.raises(OSError, match="no space"):
        disk.store.flush()
    shutil.rmtree(tmp_path / "work.zarr")
    time.sleep(0.3)
    assert not (tmp_path / "work.zarr").exists()


def test_a_mapper_maps_the_same_on_disk(tmp_path: Path, rng: np.random.Generator) -> None:
    fan = FanGeometry(1.2, 0.4, 16, 32, 0.5, 6.0)
    memory = BayesMapper(MappingSettings(voxel_m=0.1))
    disk = BayesMapper(
        MappingSettings(voxel_m=0.1), VoxelMap(0.1, TileStore.new(tmp_path / "w.zarr", SMALL))
    )
    for k in range(40):
        ping = Ping(rng.random((32, 16), np.float32) ** 4, fan)
        pose = Pose(0.8 * k, 3.0 * np.sin(k / 5.0), -2.0, yaw_rad=0.3 * k)
        for mapper in (memory, disk):
            mapper.integrate(ping, pose)
    assert memory.voxels.block_count * BYTES_PER_BLOCK > 1.2 * SMALL
    for name, mapper in (("memory", memory), ("disk", disk)):
        save_map(mapper.voxels, tmp_path / f"{name}.npz")
    assert (tmp_path / "memory.npz").read_bytes() == (tmp_path / "disk.npz").read_bytes()
    shutil.rmtree(tmp_path / "w.zarr")
