"""The origin of a map whose format cannot hold one: in a file beside it, and said aloud."""

from __future__ import annotations

import json
import logging
from pathlib import Path

from insonify.errors import MapFileError
from insonify.io.beside import BESIDE, owners_table
from insonify.io.maps.blocks import origin_of
from insonify.mapping.voxels import VoxelMap

_log = logging.getLogger(__name__)


def sidecar(path: Path) -> Path:
    """Where the origin of a map file is told."""
    return path.with_name(path.name + BESIDE)


def save_origin(voxels: VoxelMap, path: Path) -> None:
    """Write the origin of a map beside its file, if it has one."""
    if not any(voxels.origin_m):
        sidecar(path).unlink(missing_ok=True)
        return
    sidecar(path).write_text(json.dumps({"origin_m": list(voxels.origin_m)}) + "\n")
    x, y, z = voxels.origin_m
    _log.warning(
        "%s holds places relative to (%.9g, %.9g, %.9g) m, which its format cannot tell; %s does",
        path.name, x, y, z, sidecar(path).name,
    )  # fmt: skip


def load_origin(path: Path) -> tuple[float, float, float]:
    """The origin told beside a map file; zero if none is.

    Raises:
        MapFileError: It is told, but no place.
    """
    beside = sidecar(path)
    if not beside.is_file():
        return 0.0, 0.0, 0.0
    try:
        told = owners_table(json.loads(beside.read_text(encoding="utf-8")), path)["origin_m"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as err:
        raise MapFileError(f"{beside}: does not tell an origin ({err})") from err
    return origin_of(beside, told)
