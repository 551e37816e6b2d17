"""The clusters of uncertainty (Park et al. 2025, section 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.planning.dbscan import NOISE, dbscan
from insonify.types import Float32, Float64, Int64


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """The largest cluster of high-entropy voxels, C_max.

    Attributes:
        voxels_m: (N, 3) centres of its voxels, world frame.
        voxel_entropy: (N,) their entropy, bits.
        centre_m: X_center, their mean.
        radius_m: Largest horizontal distance of a voxel from the centre.
        entropy: H_total, the sum of its voxels' entropy, bits.
    """

    voxels_m: Float64
    voxel_entropy: Float32
    centre_m: tuple[float, float, float]
    radius_m: float
    entropy: float

    @classmethod
    def of(cls, voxels_m: Float64, voxel_entropy: Float32) -> Cluster:
        """The cluster of voxels (N, 3) with their entropy (N,)."""
        x, y, z = (float(c) for c in voxels_m.mean(axis=0))
        radius_m = float(np.hypot(voxels_m[:, 0] - x, voxels_m[:, 1] - y).max())
        bits = float(voxel_entropy.sum(dtype=np.float64))
        return cls(voxels_m, voxel_entropy, (x, y, z), radius_m, bits)


def largest_cluster(
    voxels: Int64, entropy: Float32, voxel_m: float, eps_m: float, min_samples: int
) -> Cluster | None:
    """C_max: the cluster with the most voxels, the first of equals; None if all is noise.

    Args:
        voxels: (N, 3) voxel indices.
        entropy: (N,) their entropy.
        voxel_m: Edge length of a voxel.
        eps_m: DBSCAN's radius.
        min_samples: DBSCAN's density, the voxel itself counted.
    """
    labels = dbscan(voxels, eps_m / voxel_m, min_samples)
    sizes = np.bincount(labels[labels != NOISE])
    if len(sizes) == 0:
        return None
    members = labels == int(np.argmax(sizes))
    return Cluster.of((voxels[members] + 0.5) * voxel_m, entropy[members])
