"""Voxel maps as files: our own, which loads back whole, and point clouds for other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.errors import MapFileError
from insonify.io.archives import read_archive
from insonify.mapping.voxels import (
    BLOCK,
    FARTHEST_BLOCK,
    IN_VIEW,
    OBSERVED,
    VOXELS_PER_BLOCK,
    VoxelMap,
    probability_from_log_odds,
)
from insonify.planning.entropy import binary_entropy
from insonify.types import Box

FORMAT = "insonify-map"
VERSION = 1


def save_map(voxels: VoxelMap, path: Path) -> None:
    """Write a map as a NumPy archive (``.npz``), its blocks in ascending order.

    Arrays: ``format``, ``version``, ``voxel_m``, ``coords`` (blocks, 3) int32, ``log_odds``
    (blocks, 512) float32 and ``seen`` (blocks, 512) uint8, voxels of a block x outermost.  The
    same map gives the same bytes.
    """
    order = np.lexsort(voxels.coords.T[::-1])
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            format=np.array(FORMAT),
            version=np.array(VERSION),
            voxel_m=np.array(voxels.voxel_m),
            coords=voxels.coords[order],
            log_odds=voxels.log_odds[order],
            seen=voxels.seen[order],
        )


def load_map(path: Path | str) -> VoxelMap:
    """Read a map written by `save_map`.

    Raises:
        MapFileError: The file is missing, is no such map, or is damaged.
    """
    path = Path(path)
    arrays = read_archive(path, FORMAT, VERSION, MapFileError)
    try:
        voxel_m = float(arrays["voxel_m"])
        coords, log_odds, seen = (arrays[name] for name in ("coords", "log_odds", "seen"))
    except (KeyError, TypeError, ValueError) as err:
        raise MapFileError(f"{path}: damaged, it lacks or garbles an array ({err})") from err
    kinds = (coords.dtype.kind, log_odds.dtype.kind, seen.dtype.kind)
    if kinds != ("i", "f", "u") or coords.ndim != 2:
        raise MapFileError(f"{path}: damaged, its arrays are of the wrong kind")
    blocks = len(coords)
    shapes = (coords.shape, log_odds.shape, seen.shape)
    if shapes != ((blocks, 3), (blocks, VOXELS_PER_BLOCK), (blocks, VOXELS_PER_BLOCK)):
        raise MapFileError(f"{path}: damaged, its arrays have shapes {shapes}")
    if not (np.isfinite(log_odds).all() and 0.0 < voxel_m < np.inf):
        raise MapFileError(f"{path}: damaged, it holds numbers that are not finite")
    far = blocks and int(np.abs(coords.astype(np.int64)).max()) >= FARTHEST_BLOCK
    if far or len(np.unique(coords, axis=0)) != blocks or (seen > (IN_VIEW | OBSERVED)).any():
        raise MapFileError(f"{path}: damaged, its blocks make no sense")
    if np.abs(log_odds).max(initial=0.0) > 100.0:
        raise MapFileError(f"{path}: damaged, it holds log-odds beyond 100")
    voxels = VoxelMap(voxel_m)
    slots = voxels.allocate(coords.astype(np.int32))
    voxels.log_odds[slots] = log_odds
    voxels.seen[slots] = seen
    return voxels


def save_point_cloud(voxels: VoxelMap, path: Path, least_entropy: float, region: Box) -> None:
    """Write a binary PLY point cloud of the voxels that are not known to be free.

    Those are the occupied voxels, and in ``region`` those in view and undecided, with properties
    ``x, y, z`` (centre, metres), ``probability`` and ``entropy``, sorted by x, y, z.

    Args:
        voxels: The map.
        path: The file.
        least_entropy: Entropy from which a voxel counts as undecided.
        region: Where undecided voxels are of interest.
    """
    entropy = binary_entropy(probability_from_log_odds(voxels.log_odds))
    corner = voxels.coords * voxels.block_m
    near = np.logical_and(corner + voxels.block_m > region.low_m, corner < region.high_m)
    undecided = (entropy >= least_entropy) & near.all(axis=1).reshape(-1, 1)
    kept = (voxels.seen > 0) & ((voxels.log_odds > 0.0) | undecided)
    slot, voxel = np.nonzero(kept)
    within = np.column_stack(np.unravel_index(voxel, (BLOCK, BLOCK, BLOCK)))
    index = voxels.coords[slot] * BLOCK + within
    centre = (index + 0.5) * voxels.voxel_m
    inside = ((centre >= region.low_m) & (centre <= region.high_m)).all(axis=1)
    inside |= voxels.log_odds[slot, voxel] > 0.0
    slot, voxel, index = slot[inside], voxel[inside], index[inside]
    order = np.lexsort(index.T[::-1])
    names = ("x", "y", "z", "probability", "entropy")
    points = np.empty(len(index), [(name, "<f4") for name in names])
    for axis, name in enumerate("xyz"):
        points[name] = ((index[:, axis] + 0.5) * voxels.voxel_m)[order]
    points["probability"] = probability_from_log_odds(voxels.log_odds[slot, voxel])[order]
    points["entropy"] = entropy[slot, voxel][order]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in names]
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode())
        file.write(points.tobytes())
