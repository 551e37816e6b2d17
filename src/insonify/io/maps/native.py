"""Our own map file: one NumPy archive that loads back whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import MapFileError
from insonify.io.archives import read_archive
from insonify.io.maps.blocks import ascending, map_from_blocks
from insonify.mapping.voxels import VoxelMap

FORMAT = "insonify-map"
VERSION = 1


def save_npz(voxels: VoxelMap, path: Path) -> None:
    """Write a map as a NumPy archive (``.npz``), its blocks in ascending order.

    Arrays: ``format``, ``version``, ``voxel_m``, ``coords`` (blocks, 3) int32, ``log_odds``
    (blocks, 512) float32 and ``seen`` (blocks, 512) uint8, voxels of a block x outermost; and
    ``origin_m`` (3,) float64 if the map has one.  The same map gives the same bytes.
    """
    order = ascending(voxels)
    more: dict[str, Any] = {"origin_m": np.array(voxels.origin_m)} if any(voxels.origin_m) else {}
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            format=np.array(FORMAT),
            version=np.array(VERSION),
            voxel_m=np.array(voxels.voxel_m),
            coords=voxels.coords[order],
            log_odds=voxels.log_odds[order],
            seen=voxels.seen[order],
            **more,
        )


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
