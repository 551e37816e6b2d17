"""Voxels as a PLY point cloud, for programs that show points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.io.maps.colours import probability_colours
from insonify.mapping.voxels import BLOCK, VoxelMap, probability_from_log_odds
from insonify.planning.entropy import binary_entropy
from insonify.types import Box

_PLY = {"<f8": "double", "<f4": "float", "u1": "uchar"}
_COLOURS = ("red", "green", "blue")
EVERYWHERE = Box((-np.inf,) * 3, (np.inf,) * 3)


def save_point_cloud(
    voxels: VoxelMap, path: Path, least_entropy: float = 0.99, region: Box = EVERYWHERE
) -> None:
    """Write a binary PLY point cloud of the voxels that are not known to be free.

    Those are the voxels that are occupied or of the surface, and in ``region`` those in view and
    undecided, with properties ``x, y, z`` (centre, metres, in the world), ``probability``,
    ``entropy``, ``surface`` (1 where an object's surface passes through) and ``red, green, blue``
    by probability, sorted by x, y, z.
    Of a map with an origin the centres are of double precision.

    Args:
        voxels: The map.
        path: The file.
        least_entropy: Entropy from which a voxel counts as undecided.
        region: Where undecided voxels are of interest, in the map's own frame.
    """
    entropy = binary_entropy(probability_from_log_odds(voxels.log_odds))
    corner = voxels.coords * voxels.block_m
    near = np.logical_and(corner + voxels.block_m > region.low_m, corner < region.high_m)
    undecided = (entropy >= least_entropy) & near.all(axis=1).reshape(-1, 1)
    surface = voxels.surface
    shown = (voxels.log_odds > 0.0) | surface
    kept = (voxels.seen > 0) & (shown | undecided)
    slot, voxel = np.nonzero(kept)
    within = np.column_stack(np.unravel_index(voxel, (BLOCK, BLOCK, BLOCK)))
    index = voxels.coords[slot] * BLOCK + within
    centre = (index + 0.5) * voxels.voxel_m
    inside = ((centre >= region.low_m) & (centre <= region.high_m)).all(axis=1)
    inside |= shown[slot, voxel]
    slot, voxel, index = slot[inside], voxel[inside], index[inside]
    order = np.lexsort(index.T[::-1])
    names = ("x", "y", "z", "probability", "entropy")
    far = any(voxels.origin_m)
    kinds = {name: "<f8" if far and name in "xyz" else "<f4" for name in names}
    kinds |= dict.fromkeys(("surface", *_COLOURS), "u1")
    points = np.empty(len(index), list(kinds.items()))
    for axis, name in enumerate("xyz"):
        points[name] = ((index[:, axis] + 0.5) * voxels.voxel_m)[order] + voxels.origin_m[axis]
    points["probability"] = probability_from_log_odds(voxels.log_odds[slot, voxel])[order]
    points["entropy"] = entropy[slot, voxel][order]
    points["surface"] = surface[slot, voxel][order]
    for name, shade in zip(_COLOURS, probability_colours(points["probability"]).T, strict=False):
        points[name] = shade
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property {_PLY[kind]} {name}" for name, kind in kinds.items()]
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode())
        file.write(points.tobytes())
