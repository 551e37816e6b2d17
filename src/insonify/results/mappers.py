"""A mapper's own state beside its map, so that it can go on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.errors import ResultError
from insonify.io.archives import read_archive
from insonify.mapping.mapper import Mapper

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


def load_state(mapper: Mapper, folder: Path) -> None:
    """Give a mapper back what `save_mapper` wrote of one of its kind, if it wrote anything.

    Raises:
        ResultError: The file is damaged, or another mapper's.
    """
    path = folder / STATE
    if not path.is_file():
        return
    arrays = read_archive(path, _FORMAT, _VERSION, ResultError)
    if str(arrays.get("mapper")) != mapper.name:
        raise ResultError(
            f"{path}: the state of mapper {arrays.get('mapper')}, not of {mapper.name}"
        )
    mapper.load(
        {name.removeprefix("state_"): arrays[name] for name in arrays if name.startswith("state_")}
    )
