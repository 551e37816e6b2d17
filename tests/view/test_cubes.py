"""Cubes: what can be seen of a map, and nothing lost when they are merged."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import ndimage

from insonify.mapping.voxels import IN_VIEW, VoxelMap, probability_from_log_odds
from insonify.types import Array, Box
from insonify.view import cubes
from insonify.view.cubes import Cubes, occupied_cubes, undecided_cubes

MakeMap = Callable[..., VoxelMap]
WHOLE = Box((-9.0,) * 3, (9.0,) * 3)


def _dense(found: Cubes, reach: int) -> Array:
    grid = np.zeros((2 * reach,) * 3, np.float32)
    grid[tuple((found.index + reach).T)] = found.value
    return grid


def _map(rng: np.random.Generator) -> VoxelMap:
    """Some blocks of a solid ball and of noise, some missing."""
    voxels = VoxelMap(0.25)
    around = np.stack(np.meshgrid(*[np.arange(-2, 2)] * 3, indexing="ij"), -1).reshape(-1, 3)
    slots = voxels.allocate(around[rng.random(len(around)) < 0.8].astype(np.int32))
    within = np.column_stack(np.unravel_index(np.arange(512), (8, 8, 8)))
    index = voxels.coords[:, None, :] * 8 + within
    ball = np.linalg.norm(index, axis=2) < 11
    noise = rng.normal(size=ball.shape)
    voxels.log_odds[slots] = np.where(ball, 2.0 + np.abs(noise), noise - 1.0)
    voxels.seen[slots] = IN_VIEW
    return voxels


def test_the_outside_of_the_occupied_voxels(rng: np.random.Generator) -> None:
    voxels = _map(rng)
    window = voxels.window(Box((-4.0,) * 3, (4.0,) * 3))
    inner = ndimage.binary_erosion(window.occupied)
    wanted = np.where(window.occupied & ~inner, window.probability, 0)
    assert inner.sum() > 0
    there, elsewhere = occupied_cubes(voxels, WHOLE)
    np.testing.assert_array_equal(_dense(there, 16), wanted)
    assert there.count == window.occupied.sum()
    assert elsewhere.count == 0 and len(elsewhere.index) == 0


def test_what_lies_in_a_region_and_what_does_not(make_map: MakeMap) -> None:
    voxels = make_map(1, blocks=9, reach=3)
    region = Box((-1.0, -0.5, -2.0), (1.2, 2.0, 0.3))
    there, elsewhere = occupied_cubes(voxels, region)
    all_there, _ = occupied_cubes(voxels, WHOLE)
    low, high = np.array(region.low_m), np.array(region.high_m)
    inside = np.logical_and(all_there.centres_m >= low, all_there.centres_m <= high).all(axis=1)
    assert 0 < inside.sum() < len(all_there.index)
    np.testing.assert_array_equal(there.index, all_there.index[inside])
    np.testing.assert_array_equal(elsewhere.index, all_there.index[~inside])
    assert there.count + elsewhere.count == (voxels.log_odds > 0).sum()


def test_undecided_voxels_of_a_region(make_map: MakeMap) -> None:
    voxels = make_map(2, blocks=9, reach=3)
    region = Box((-1.0, -0.5, -2.0), (1.2, 2.0, 0.3))
    found = undecided_cubes(voxels, region)
    window = voxels.window(region)
    p = window.probability.astype(np.float64)
    entropy = -(p * np.log2(p) + (1 - p) * np.log2(1 - p))
    doubtful = (entropy >= 0.5) & ((window.seen & IN_VIEW) > 0)
    assert found.count == len(found.index) == doubtful.sum() > 0
    order = np.lexsort(found.index.T[::-1])
    index = np.argwhere(doubtful) + window.first
    np.testing.assert_array_equal(found.index[order], index)
    np.testing.assert_allclose(found.value[order], entropy[doubtful], atol=1e-6)


def test_merged_cubes_cover_all_and_keep_the_largest(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    voxels = _map(rng)
    fine, _ = occupied_cubes(voxels, WHOLE)
    monkeypatch.setattr(cubes, "MOST_CUBES", 400)
    coarse, _ = occupied_cubes(voxels, WHOLE)
    assert len(coarse.index) <= 400 < len(fine.index)
    assert coarse.times in (2, 4, 8) and coarse.edge_m == coarse.times * 0.25
    assert coarse.count == fine.count
    largest: dict[tuple[int, ...], float] = {}
    for index, value in zip(fine.index // coarse.times, fine.value, strict=True):
        key = tuple(index.tolist())
        largest[key] = max(largest.get(key, 0.0), float(value))
    found = zip(map(tuple, coarse.index.tolist()), coarse.value.tolist(), strict=True)
    assert dict(found) == largest


def test_an_empty_map_has_no_cubes() -> None:
    there, elsewhere = occupied_cubes(VoxelMap(0.1), WHOLE)
    assert len(there.index) == len(elsewhere.index) == 0
    assert len(undecided_cubes(VoxelMap(0.1), WHOLE).index) == 0


def test_a_cube_lies_on_its_voxel(make_map: MakeMap) -> None:
    voxels = make_map(3)
    there, _ = occupied_cubes(voxels, WHOLE)
    index = np.floor(there.centres_m / 0.1).astype(int)
    slot = voxels.find((index // 8).astype(np.int32))
    place = np.ravel_multi_index(tuple((index % 8).T), (8, 8, 8))
    value = probability_from_log_odds(voxels.log_odds[slot, place])
    np.testing.assert_array_equal(there.value, value)
