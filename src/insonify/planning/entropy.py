"""The entropy map: how undecided each voxel is (Park et al. 2025, section 2.2)."""

from __future__ import annotations

import numpy as np

from insonify.mapping.voxels import IN_VIEW, VoxelWindow
from insonify.types import Bool, Float32


def binary_entropy(probability: Float32) -> Float32:
    """H(m) in bits, any shape (eq. 3); 0 at p = 0 and p = 1, 1 at p = 0.5."""
    p = np.asarray(probability, np.float32)
    q = np.float32(1.0) - p
    with np.errstate(divide="ignore", invalid="ignore"):
        entropy = -(p * np.log2(p) + q * np.log2(q))
    return np.where((p <= 0.0) | (q <= 0.0), np.float32(0.0), entropy)


def entropy_map(window: VoxelWindow) -> Float32:
    """H of every voxel of a window; a voxel that was never seen has H = 1."""
    return binary_entropy(window.probability)


def high_entropy_voxels(window: VoxelWindow, entropy: Float32, threshold: float) -> Bool:
    """Voxels that have been inside the sonar's field of view and are still undecided.

    Voxels never looked at have H = 1 too, but say nothing about where a scan left doubt: with
    them, one cluster would fill the designated area.

    Args:
        window: The designated area.
        entropy: Its entropy map.
        threshold: Least entropy that counts as high (Table 1: 0.99).
    """
    in_view: Bool = (window.seen & IN_VIEW) > 0
    return in_view & (entropy >= threshold)
