"""Maps as Zarr (version 3): chunks of neighbouring blocks, so that a region loads without the rest.

Blocks lie along a Z-order curve, 256 to a chunk.  Each chunk has a checksum, and what stands in
for a missing chunk is no valid value, so that damage is noticed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import MapFileError
from insonify.extras import optional
from insonify.io.maps.blocks import check_memory, map_from_blocks
from insonify.io.maps.octree import interleave
from insonify.mapping.voxels import (
    BLOCK,
    FARTHEST_BLOCK,
    VOXELS_PER_BLOCK,
    VoxelMap,
    touching,
)
from insonify.types import Array, Box

FORMAT, VERSION = "insonify-map", 2
BLOCKS_PER_CHUNK = 256
_ARRAYS = {
    "coords": (np.int32, 3, 16 * BLOCKS_PER_CHUNK, -(2**31)),
    "log_odds": (np.float32, VOXELS_PER_BLOCK, BLOCKS_PER_CHUNK, float("nan")),
    "seen": (np.uint8, VOXELS_PER_BLOCK, BLOCKS_PER_CHUNK, 255),
}
_DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    ImportError,
)
"""What Zarr and its codecs raise on metadata and chunks with flipped or missing bytes."""


def save_zarr(voxels: VoxelMap, path: Path) -> None:
    """Write a map as a new Zarr group.

    Attributes ``format``, ``version``, ``voxel_m`` and, if there is one, ``origin_m``; arrays
    ``coords`` (blocks, 3) int32, ``log_odds`` (blocks, 512) float32 and ``seen`` (blocks, 512)
    uint8, as in `save_npz`.

    Raises:
        MissingExtraError: The package zarr is not installed.
    """
    zarr = optional("zarr", "maps", "a .zarr map")
    order = np.argsort(interleave(voxels.coords.astype(np.int64) + FARTHEST_BLOCK, bits=21))
    about = {"format": FORMAT, "version": VERSION, "voxel_m": voxels.voxel_m}
    if any(voxels.origin_m):
        about["origin_m"] = list(voxels.origin_m)
    group = zarr.create_group(path, zarr_format=3, attributes=about)
    for name, (kind, width, rows, nothing) in _ARRAYS.items():
        array = group.create_array(
            name,
            shape=(len(order), width),
            chunks=(rows, width),
            dtype=kind,
            fill_value=nothing,
            compressors=[zarr.codecs.ZstdCodec(level=5), zarr.codecs.Crc32cCodec()],
            dimension_names=("block", {"coords": "axis"}.get(name, "voxel")),
        )
        if len(order):
            array[:] = getattr(voxels, name)[order]


def load_zarr(path: Path, region: Box | None = None) -> VoxelMap:
    """Read a map written by `save_zarr`, or the part of it whose blocks touch ``region``.

    Raises:
        MapFileError: The folder is no such map, or is damaged.
        MissingExtraError: The package zarr is not installed.
    """
    zarr = optional("zarr", "maps", "a .zarr map")
    try:
        group = zarr.open_group(path, mode="r", zarr_format=3)
        if group.attrs["format"] != FORMAT or group.attrs["version"] != VERSION:
            raise MapFileError(
                f"{path}: not a version {VERSION} insonify map; write it again with this version"
            )
        voxel_m = float(group.attrs["voxel_m"])
        origin_m = group.attrs.get("origin_m", (0.0, 0.0, 0.0))
        arrays = {name: group[name] for name in _ARRAYS}
        _check_layout(path, arrays)
        coords = arrays["coords"][:]
        rows = np.arange(len(coords))
        if region is not None and 0.0 < voxel_m < np.inf:
            rows = np.flatnonzero(touching(coords, BLOCK * voxel_m, region))
        check_memory(path, len(rows))
        log_odds, seen = (_rows(arrays[name], rows) for name in ("log_odds", "seen"))
    except _DAMAGE as err:
        reason = " ".join(str(err).split())
        raise MapFileError(f"{path}: damaged, or not an insonify map ({reason:.200})") from err
    return map_from_blocks(path, voxel_m, coords[rows], log_odds, seen, origin_m)


def _check_layout(path: Path, arrays: dict[str, Any]) -> None:
    """Refuse arrays whose reading might need more memory than the map.

    Raises:
        MapFileError: They are not as `save_zarr` lays them out.
    """
    blocks = arrays["coords"].shape[0]
    for name, (kind, width, rows, _) in _ARRAYS.items():
        array = arrays[name]
        layout = (array.shape, array.chunks, array.dtype)
        if layout != ((blocks, width), (rows, width), np.dtype(kind)):
            raise MapFileError(f"{path}: damaged, {name} is laid out as {layout}")
    if blocks > (2 * FARTHEST_BLOCK) ** 2:
        raise MapFileError(f"{path}: damaged, it announces {blocks} blocks")
    check_memory(path, blocks // 200)  # a block's coordinates are 1/200 of the block


def _rows(array: Any, rows: Array) -> Array:
    """Some rows of an array; only the chunks that hold them are read."""
    if len(rows) == array.shape[0]:
        found: Array = array[:]
        return found
    picked: Array = array.get_orthogonal_selection((rows, slice(None)))
    return picked
