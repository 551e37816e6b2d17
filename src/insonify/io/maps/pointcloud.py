"""Voxels as a PLY point cloud, for programs that show points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.io.maps.colours import probability_colours
from insonify.mapping.voxels import (
    Blocks,
    VoxelMap,
    probability_from_log_odds,
    surface_of,
)
from insonify.planning.entropy import binary_entropy
from insonify.types import Bool, Box

_PLY = {"<f8": "double", "<f4": "float", "u1": "uchar"}
_COLOURS = ("red", "green", "blue")


def save_point_cloud(
    voxels: VoxelMap, path: Path, least_entropy: float = 0.99, region: Box | None = None
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
        region: Where undecided voxels are of interest, in the map's own frame; by default
            everywhere.
    """
    marked = voxels.marked

    def shown(part: Blocks) -> Bool:
        undecided = binary_entropy(probability_from_log_odds(part.log_odds)) >= least_entropy
        if region is not None:
            undecided &= voxels.inside(part.coords, region)
        solid = (part.log_odds > 0.0) | surface_of(part.log_odds, part.seen, marked)
        return np.asarray((part.seen > 0) & (solid | undecided), bool)

    some = voxels.select(shown)
    order = np.lexsort(some.index.T[::-1])
    index, log_odds, seen = some.index[order], some.log_odds[order], some.seen[order]
    names = ("x", "y", "z", "probability", "entropy")
    far = any(voxels.origin_m)
    kinds = {name: "<f8" if far and name in "xyz" else "<f4" for name in names}
    kinds |= dict.fromkeys(("surface", *_COLOURS), "u1")
    points = np.empty(len(index), list(kinds.items()))
    for axis, name in enumerate("xyz"):
        points[name] = (index[:, axis] + 0.5) * voxels.voxel_m + voxels.origin_m[axis]
    points["probability"] = probability_from_log_odds(log_odds)
    points["entropy"] = binary_entropy(points["probability"])
    points["surface"] = surface_of(log_odds, seen, marked)
    for name, shade in zip(_COLOURS, probability_colours(points["probability"]).T, strict=False):
        points[name] = shade
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property {_PLY[kind]} {name}" for name, kind in kinds.items()]
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode())
        file.write(points.tobytes())
