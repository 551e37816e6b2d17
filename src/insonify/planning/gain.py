"""What a pose would see: the entropy of the voxels that a look from it would tell about.

Park et al. 2025, eq. 6: ``H_sum = sum over beams b, sum over m in M_b of H(m)``.  Which voxels M_b
holds, and how much of their entropy a look would take away, is the mapper's to say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from insonify.jit import kernel
from insonify.mapping.mapper import Belief
from insonify.types import FanGeometry, Float32, Float64, Pose

_MOST_SHARES = 32_000_000
"""Poses are asked about in groups, so that no more shares than this are held at once."""


def expected_gain(
    belief: Belief,
    poses: Sequence[Pose],
    geometry: FanGeometry,
    voxels_m: Float64,
    entropy: Float32,
) -> Float64:
    """H_sum of each pose (eq. 6); every voxel counts once.

    Args:
        belief: The map, and what a look would tell about it.
        poses: Vehicle poses.
        geometry: The sonar.
        voxels_m: (N, 3) centres of the voxels whose entropy counts, world frame.
        entropy: (N,) their entropy.

    Returns:
        (poses,) bits.
    """
    sums = np.zeros(len(poses))
    step = max(1, _MOST_SHARES // max(1, len(voxels_m)))
    for start in range(0, len(poses), step):
        some = poses[start : start + step]
        shares = belief.tells(some, geometry, voxels_m)
        sums[start : start + step] = _weighted_sums(shares, entropy)
    return sums


@kernel
def _weighted_sums(shares: Float32, entropy: Float32) -> Float64:
    """Sums (poses,) one after another in double precision, the same whatever the threads."""
    sums = np.zeros(len(shares))
    for pose in range(len(shares)):
        for i in range(shares.shape[1]):
            sums[pose] += shares[pose, i] * entropy[i]
    return sums
