"""Maps as Zarr: written tile by tile, read whole, in part, or as they are needed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import MapFileError
from insonify.io.maps.blocks import check_memory, cropped, map_from_blocks
from insonify.io.maps.ondisk import LEAST_BYTES, TileStore
from insonify.io.maps.tiles import (
    BLOCKS_PER_TILE,
    DAMAGE,
    About,
    TileFiles,
    describe,
    places_of,
)
from insonify.mapping.store import TILE
from insonify.mapping.voxels import BLOCK, VOXELS_PER_BLOCK, Blocks, VoxelMap, touching
from insonify.types import Array, Box, Float32, Int32

_AT_ONCE = 16


def save_zarr(voxels: VoxelMap, path: Path) -> None:
    """Write a map as a new Zarr group.

    Attributes ``format``, ``version``, ``voxel_m``, ``first_voxel`` (the world index of element
    0, 0, 0), ``seen_as`` (all bits of ``seen``) and, if there is one, ``origin_m``; arrays
    ``log_odds`` float32 and ``seen`` uint8 over ``x``, ``y`` and ``z``, which are there too; and
    ``coords`` (blocks, 3) int32, which blocks of 8 x 8 x 8 voxels there are.  The same map gives
    the same bytes.

    Raises:
        MissingExtraError: The package zarr is not installed.
    """
    files = TileFiles(path)
    path.mkdir()
    listed, tiles = [], _tiles(voxels)
    while some := list(islice(tiles, _AT_ONCE)):
        listed += [coords for _, coords, _, _ in some]
        files.write((tile, log_odds, seen) for tile, _, log_odds, seen in some)
    files.commit()
    coords = np.concatenate([np.empty((0, 3), np.int32), *listed])
    files.settle(np.unique(coords // TILE, axis=0))
    describe(path, coords, files.first, voxels.voxel_m, voxels.origin_m, voxels.bits)


def load_zarr(path: Path, region: Box | None = None, memory_bytes: int | None = None) -> VoxelMap:
    """Read a map written by `save_zarr`.

    Args:
        path: The group.
        region: Only the blocks that touch this box, into memory.
        memory_bytes: Or all of it, but tiles as they are needed, with so much memory for them; such
            a map cannot be written to.

    Raises:
        MapFileError: The folder is no such map, or is damaged; with ``memory_bytes``, damage of a
            tile is found when the tile is read.
        MemoryLimitError: The memory is too little.
        MissingExtraError: The package zarr is not installed.
    """
    about = About(path)
    if about.version == 2:
        if memory_bytes is not None:
            raise MapFileError(
                f"{path}: is of version 2, which is read whole; export it to a new .zarr, and give "
                "--memory with that"
            )
        return _load_rows(path, about, region)
    if memory_bytes is not None and region is None:
        return VoxelMap(about.voxel_m, TileStore.opened(path, about, memory_bytes), about.origin_m)
    store = TileStore.opened(path, about, LEAST_BYTES)
    whole = VoxelMap(about.voxel_m, store, about.origin_m)
    blocks = store.count
    if region is not None:
        blocks = int(touching(store.coords, whole.block_m, region).sum())
    check_memory(path, blocks)
    return cropped(whole, region)


def _tiles(voxels: VoxelMap) -> Iterator[tuple[Int32, Int32, Float32, Array]]:
    """Index, blocks, log-odds and seen (512, 512) of each tile of a map."""
    rest = Blocks(*(np.empty((0, width), kind) for width, kind in _ROWS.values()))
    for part in voxels.parts(order="tiles"):
        arrays = [np.concatenate([getattr(rest, name), getattr(part, name)]) for name in _ROWS]
        tiles = arrays[0] // TILE
        ends = np.flatnonzero((tiles[1:] != tiles[:-1]).any(axis=1)) + 1
        for start, end in zip([0, *ends[:-1]], ends, strict=True) if len(ends) else ():
            yield _tile(*(array[start:end] for array in arrays))
        rest = Blocks(*(array[ends[-1] if len(ends) else 0 :] for array in arrays))
    if len(rest.coords):
        yield _tile(rest.coords, rest.log_odds, rest.seen)


def _tile(coords: Int32, some: Float32, seen: Array) -> tuple[Int32, Int32, Float32, Array]:
    tiles, places = places_of(coords)
    log_odds = np.zeros((BLOCKS_PER_TILE, VOXELS_PER_BLOCK), np.float32)
    bits = np.zeros((BLOCKS_PER_TILE, VOXELS_PER_BLOCK), np.uint8)
    log_odds[places], bits[places] = some, seen
    return tiles[0], coords, log_odds, bits


_ROWS = {
    "coords": (3, np.int32),
    "log_odds": (VOXELS_PER_BLOCK, np.float32),
    "seen": (VOXELS_PER_BLOCK, np.uint8),
}


def _load_rows(path: Path, about: About, region: Box | None) -> VoxelMap:
    """Read a map of version 2, which has its blocks as rows of two-dimensional arrays."""
    try:
        arrays = {name: about.group[name] for name in _ROWS}
        _check_rows(path, arrays)
        coords = arrays["coords"][:]
        rows = np.arange(len(coords))
        if region is not None:
            rows = np.flatnonzero(touching(coords, BLOCK * about.voxel_m, region))
        check_memory(path, len(rows))
        log_odds, seen = (
            arrays[name].get_orthogonal_selection((rows, slice(None)))
            for name in ("log_odds", "seen")
        )
    except DAMAGE as err:
        raise MapFileError(f"{path}: damaged, or not an insonify map ({err!s:.200})") from err
    return map_from_blocks(
        path, about.voxel_m, coords[rows], log_odds, seen, np.array(about.origin_m)
    )


def _check_rows(path: Path, arrays: dict[str, Any]) -> None:
    """Refuse arrays whose reading might need more memory than the map.

    Raises:
        MapFileError: They are not laid out as version 2 has them.
    """
    blocks = arrays["coords"].shape[0]
    for name, (width, kind) in _ROWS.items():
        array = arrays[name]
        layout = (array.shape, array.dtype)
        if layout != ((blocks, width), np.dtype(kind)) or array.chunks[0] > 4096:
            raise MapFileError(f"{path}: damaged, {name} is laid out as {layout}")
    check_memory(path, blocks // 200)  # a block's coordinates are 1/200 of the block
