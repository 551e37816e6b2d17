"""Blocks of voxels from a file: checked, then made a map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from insonify import memory
from insonify.errors import MapFileError
from insonify.limits import LARGEST_VOXEL_M, LEAST_VOXEL_M
from insonify.mapping.voxels import (
    BYTES_PER_VOXEL,
    FARTHEST_BLOCK,
    IN_VIEW,
    OBSERVED,
    SURFACE,
    VOXELS_PER_BLOCK,
    VoxelMap,
)
from insonify.types import Array, Box

MOST_LOG_ODDS = 100.0
FARTHEST_ORIGIN_M = 1e9


def map_from_blocks(
    path: Path, voxel_m: float, coords: Array, log_odds: Array, seen: Array, origin_m: Array
) -> VoxelMap:
    """A map of the blocks that a file holds.

    Args:
        path: The file, for messages.
        voxel_m: Edge length of a voxel.
        coords: (blocks, 3) integers.
        log_odds: (blocks, 512) floats.
        seen: (blocks, 512) unsigned integers.
        origin_m: (3,) the map's own frame in the world.

    Raises:
        MapFileError: They make no sense.
    """
    kinds = (coords.dtype.kind, log_odds.dtype.kind, seen.dtype.kind)
    if kinds != ("i", "f", "u") or coords.ndim != 2:
        raise MapFileError(f"{path}: damaged, its arrays are of the wrong kind")
    blocks = len(coords)
    shapes = (coords.shape, log_odds.shape, seen.shape)
    if shapes != ((blocks, 3), (blocks, VOXELS_PER_BLOCK), (blocks, VOXELS_PER_BLOCK)):
        raise MapFileError(f"{path}: damaged, its arrays have shapes {shapes}")
    if not np.isfinite(log_odds).all():
        raise MapFileError(f"{path}: damaged, it holds numbers that are not finite")
    check_voxel(path, voxel_m)
    far = blocks and int(np.abs(coords.astype(np.int64)).max()) >= FARTHEST_BLOCK
    known = IN_VIEW | OBSERVED | SURFACE
    if far or len(np.unique(coords, axis=0)) != blocks or (seen > known).any():
        raise MapFileError(f"{path}: damaged, its blocks make no sense")
    if np.abs(log_odds).max(initial=0.0) > MOST_LOG_ODDS:
        raise MapFileError(f"{path}: damaged, it holds log-odds beyond {MOST_LOG_ODDS:g}")
    voxels = VoxelMap(voxel_m, origin_m=origin_of(path, origin_m))
    slots = voxels.allocate(coords.astype(np.int32))
    voxels.log_odds[slots] = log_odds
    voxels.seen[slots] = seen
    return voxels


def origin_of(path: Path, told: Any) -> tuple[float, float, float]:
    """The origin that a file tells, three finite numbers.

    Raises:
        MapFileError: It is no place.
    """
    try:
        x, y, z = (float(c) for c in told)
    except (TypeError, ValueError) as err:
        raise MapFileError(f"{path}: damaged, its origin is no place ({err})") from err
    if not all(math.isfinite(c) and abs(c) < FARTHEST_ORIGIN_M for c in (x, y, z)):
        raise MapFileError(f"{path}: damaged, its origin {(x, y, z)} is no place")
    return x, y, z


def cropped(voxels: VoxelMap, region: Box | None) -> VoxelMap:
    """A copy, in memory, of the blocks that touch a box, or of all."""
    part = VoxelMap(voxels.voxel_m, origin_m=voxels.origin_m)
    for blocks in voxels.parts(region):
        held = part.hold(blocks.coords)
        held.log_odds[held.slots] = blocks.log_odds
        held.seen[held.slots] = blocks.seen
    return part


def check_voxel(path: Path, voxel_m: float) -> None:
    """Refuse a file whose voxels are of a size that makes no sense.

    Raises:
        MapFileError: They are.
    """
    if not LEAST_VOXEL_M <= voxel_m <= LARGEST_VOXEL_M:
        raise MapFileError(f"{path}: damaged, a resolution of {voxel_m:g} m makes no sense")


def check_memory(path: Path, blocks: int) -> None:
    """Refuse a file whose map would not fit.

    Raises:
        MapFileError: It needs more than half of the memory that is free.
    """
    needed = blocks * VOXELS_PER_BLOCK * BYTES_PER_VOXEL
    if not memory.fits(2.0 * needed):
        raise MapFileError(
            f"{path}: its map would need {memory.shortage(2.0 * needed)}; the file is damaged, or "
            "wants a larger machine"
        )
