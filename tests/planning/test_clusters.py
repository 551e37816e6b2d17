from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import DBSCAN

from insonify.planning.clusters import largest_cluster
from insonify.planning.dbscan import dbscan


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(1, 150)),
    st.floats(0.01, 1.0),
    st.sampled_from([0.5, 1.0, 1.5, 1.75, 2.0, 2.3, 3.0, 4.2]),
    st.integers(1, 25),
)
def test_labels_are_those_of_scikit_learn(
    seed: int, shape: tuple[int, int, int], density: float, eps: float, min_samples: int
) -> None:
    rng = np.random.default_rng(seed)
    voxels = np.argwhere(rng.random(shape) < density) + rng.integers(-1000, 1000, 3)
    voxels = rng.permutation(voxels)
    if len(voxels) == 0:
        assert len(dbscan(voxels, eps, min_samples)) == 0
        return
    expected = DBSCAN(eps=eps, min_samples=min_samples).fit(voxels).labels_
    np.testing.assert_array_equal(dbscan(voxels, eps, min_samples), expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(5.0, 20.0), st.integers(1, 6))
def test_sparse_voxels_far_apart_and_wide_neighbourhoods(
    seed: int, eps: float, min_samples: int
) -> None:
    rng = np.random.default_rng(seed)
    centres = rng.integers(-100_000, 100_000, (4, 3))
    voxels = np.unique(np.vstack([c + rng.integers(-25, 25, (60, 3)) for c in centres]), axis=0)
    expected = DBSCAN(eps=eps, min_samples=min_samples).fit(voxels).labels_
    np.testing.assert_array_equal(dbscan(voxels, eps, min_samples), expected)


def test_largest_cluster_has_its_centre_radius_and_entropy() -> None:
    slab = np.argwhere(np.ones((9, 3, 3), bool))
    dot = np.argwhere(np.ones((2, 3, 3), bool)) + np.array([40, 0, 0])
    voxels = np.vstack([dot, slab])
    entropy = np.full(len(voxels), 0.5, np.float32)
    cluster = largest_cluster(voxels, entropy, 0.1, 0.175, 5)
    assert cluster is not None
    np.testing.assert_allclose(cluster.centre_m, [0.45, 0.15, 0.15])
    assert cluster.radius_m == pytest.approx(np.hypot(0.4, 0.1))
    assert cluster.entropy == pytest.approx(81 * 0.5)
    assert len(cluster.voxels_m) == 81


def test_only_noise_is_no_cluster() -> None:
    voxels = np.array([[0, 0, 0], [5, 5, 5]])
    assert largest_cluster(voxels, np.ones(2, np.float32), 0.1, 0.175, 2) is None


@pytest.mark.parametrize(("eps", "min_samples"), [(0.0, 3), (64.0, 3), (1.0, 0)])
def test_bad_arguments_are_refused(eps: float, min_samples: int) -> None:
    with pytest.raises(ValueError, match="eps"):
        dbscan(np.zeros((1, 3), int), eps, min_samples)


def test_equal_voxels_are_refused() -> None:
    with pytest.raises(ValueError, match="distinct"):
        dbscan(np.zeros((2, 3), int), 1.0, 1)
