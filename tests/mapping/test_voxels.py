from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from insonify.mapping.voxels import BLOCK, IN_VIEW, VoxelMap, probability_from_log_odds
from insonify.types import Box


def test_an_empty_map_is_unknown_everywhere() -> None:
    window = VoxelMap(0.5).window(Box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)))
    assert window.log_odds.shape == (4, 4, 4)
    assert (window.probability == 0.5).all()
    assert not window.seen.any()
    assert not window.occupied.any()


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays(np.int32, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(-9, 9)),
    st.integers(0, 2**32 - 1),
)
def test_windows_agree_with_a_dictionary(coords: np.ndarray, seed: int) -> None:
    """Blocks in any order, read back through dense windows at arbitrary places."""
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(0.25)
    slots = voxels.allocate(coords)
    assert voxels.block_count == len(np.unique(coords, axis=0))
    np.testing.assert_array_equal(voxels.coords[slots], coords)
    voxels.log_odds[:] = rng.normal(size=voxels.log_odds.shape)
    voxels.seen[:] = IN_VIEW
    known = {}
    for coord, block in zip(voxels.coords, voxels.log_odds, strict=True):
        cube = block.reshape(BLOCK, BLOCK, BLOCK)
        for index in np.ndindex(BLOCK, BLOCK, BLOCK):
            known[tuple(coord * BLOCK + index)] = cube[index]
    low = rng.integers(-60, 40, 3)
    size = rng.integers(1, 25, 3)
    window = voxels.window(Box.of(low * 0.25, (low + size) * 0.25))
    assert window.first == tuple(low)
    assert window.log_odds.shape == tuple(size)
    for offset in rng.integers(0, size, (200, 3)):
        index = tuple(low + offset)
        assert window.log_odds[tuple(offset)] == known.get(index, 0.0)
        assert (window.seen[tuple(offset)] > 0) == (index in known)


def test_growing_keeps_what_is_there() -> None:
    voxels = VoxelMap(1.0)
    first = voxels.allocate(np.array([[0, 0, 0]], np.int32))
    voxels.log_odds[first[0], 7] = 2.5
    voxels.allocate(np.array([[i, i, -i] for i in range(1000)], np.int32))
    assert voxels.block_count == 1000
    assert voxels.log_odds[first[0], 7] == 2.5
    np.testing.assert_allclose(voxels.occupied_m(), [[0.5, 0.5, 7.5]])


def test_window_centres_and_bounds_are_in_the_world_frame() -> None:
    voxels = VoxelMap(0.5)
    voxels.allocate(np.array([[-1, 0, 2]], np.int32))
    window = voxels.window(Box((-4.0, 0.0, 8.0), (-3.0, 1.0, 9.0)))
    mask = np.zeros((2, 2, 2), bool)
    mask[1, 0, 1] = True
    np.testing.assert_allclose(window.centres_m(mask), [[-3.25, 0.25, 8.75]])


def test_probability_is_the_logistic_of_log_odds() -> None:
    np.testing.assert_allclose(
        probability_from_log_odds(np.array([0.0, np.log(3.0), -np.log(3.0)], np.float32)),
        [0.5, 0.75, 0.25],
        rtol=1e-6,
    )


@pytest.mark.parametrize("bad", [0.0, -1.0, float("inf"), float("nan")])
def test_impossible_voxel_sizes_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="voxel_m"):
        VoxelMap(bad)
