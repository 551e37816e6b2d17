"""Our own map file: one NumPy archive that loads back whole."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import MapFileError
from insonify.io.archives import read_archive
from insonify.io.maps.blocks import map_from_blocks
from insonify.mapping.voxels import VOXELS_PER_BLOCK, VoxelMap
from insonify.types import Array

FORMAT = "insonify-map"
VERSION = 1
_ARRAYS = (
    ("coords", (3,), "i4"),
    ("log_odds", (VOXELS_PER_BLOCK,), "f4"),
    ("seen", (VOXELS_PER_BLOCK,), "u1"),
)


def save_npz(voxels: VoxelMap, path: Path) -> None:
    """Write a map as a NumPy archive (``.npz``), its blocks in ascending order.

    Arrays: ``format``, ``version``, ``voxel_m``, ``coords`` (blocks, 3) int32, ``log_odds``
    (blocks, 512) float32 and ``seen`` (blocks, 512) uint8, voxels of a block x outermost; and
    ``origin_m`` (3,) float64 if the map has one.  The same map gives the same bytes.
    """
    alone = {"format": FORMAT, "version": VERSION, "voxel_m": voxels.voxel_m}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in alone.items():
            _write(archive, name, (), np.array(value).dtype, [np.array(value)])
        for name, shape, kind in _ARRAYS:
            pieces = (getattr(part, name) for part in voxels.parts(order="ascending"))
            _write(archive, name, (voxels.block_count, *shape), np.dtype(kind), pieces)
        if any(voxels.origin_m):
            _write(archive, "origin_m", (3,), np.dtype("f8"), [np.array(voxels.origin_m)])


def _write(
    archive: zipfile.ZipFile, name: str, shape: tuple[int, ...], kind: Any, pieces: Iterable[Array]
) -> None:
    """An array as `numpy.savez_compressed` writes it, but a piece at a time."""
    header = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": shape}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, header)
        for piece in pieces:
            file.write(np.ascontiguousarray(piece, kind).tobytes())


def load_npz(path: Path) -> VoxelMap:
    """Read a map written by `save_npz`.

    Raises:
        MapFileError: The file is no such map, or is damaged.
    """
    arrays = read_archive(path, FORMAT, VERSION, MapFileError)
    try:
        voxel_m = float(arrays["voxel_m"])
        coords, log_odds, seen = (arrays[name] for name in ("coords", "log_odds", "seen"))
    except (KeyError, TypeError, ValueError) as err:
        raise MapFileError(f"{path}: damaged, it lacks or garbles an array ({err})") from err
    origin_m = arrays.get("origin_m", np.zeros(3))
    return map_from_blocks(path, voxel_m, coords, log_odds, seen, origin_m)
