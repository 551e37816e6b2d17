"""A mapper's own state beside its map, so that it can go on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from insonify.errors import ResultError
from insonify.io.archives import read_archive
from insonify.mapping.mapper import Mapper
from insonify.mapping.voxels import VoxelMap
from insonify.types import Array

STATE = "mapper.npz"
_FORMAT, _VERSION = "insonify-mapper", 1


def save_mapper(mapper: Mapper, folder: Path) -> None:
    """Write what a mapper needs to go on besides its map, if it needs anything."""
    arrays = mapper.save()
    if arrays:
        with (folder / STATE).open("wb") as file:
            np.savez_compressed(
                file,
                format=np.array(_FORMAT),
                version=np.array(_VERSION),
                mapper=np.array(mapper.name),
                allow_pickle=False,
                **{f"state_{name}": values for name, values in arrays.items()},
            )


def give_back(mapper: Mapper, voxels: VoxelMap, state: Mapping[str, Array]) -> None:
    """Have a mapper with nothing mapped go on with a map, and with what it kept besides.

    A mapper that reads its voxels off others has them from these, and they follow later pings.
    """
    own = mapper.voxels
    mapper.voxels = voxels
    if state:
        mapper.load(state)
    if own is not voxels and own.block_count:
        own.origin_m = voxels.origin_m
        mapper.voxels = own


def load_state(mapper: Mapper, folder: Path) -> dict[str, Array]:
    """What `save_mapper` wrote of a mapper of this kind, nothing if it wrote nothing.

    Raises:
        ResultError: The file is damaged, or another mapper's.
    """
    path = folder / STATE
    if not path.is_file():
        return {}
    arrays = read_archive(path, _FORMAT, _VERSION, ResultError)
    if str(arrays.get("mapper")) != mapper.name:
        raise ResultError(
            f"{path}: the state of mapper {arrays.get('mapper')}, not of {mapper.name}"
        )
    return {
        name.removeprefix("state_"): arrays[name] for name in arrays if name.startswith("state_")
    }
