"""Mappers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from insonify.errors import ConfigError
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.carving import CarvingMapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.mapping.voxels import BYTES_PER_VOXEL, VoxelMap
from insonify.plugins import check_name, load_plugin, made

MAPPERS: dict[str, Callable[[MappingSettings], Mapper]] = {
    "bayes": BayesMapper,
    "carving": CarvingMapper,
}
_INSIDE: dict[str, Callable[[MappingSettings], int]] = {
    "carving": lambda settings: 1 + settings.carving.inside**3
}
"""Voxels that a mapper keeps besides its map's, for each of those."""
MAPPER_PARTS = ("name", "voxels", "integrate", "finish_scan", "tells", "save", "load")
"""What every mapper has."""


def make_mapper(
    name: str, settings: MappingSettings, options: Mapping[str, Any] | None = None
) -> Mapper:
    """A mapper with an empty map.

    Args:
        name: Of one of `MAPPERS`, or a user's own: ``module:Name`` or ``file.py:Name``.
        settings: Handed to it.
        options: Of a user's own, by keyword.

    Raises:
        ConfigError: There is none of that name, or it is no mapper.
    """
    check_mapper(name, options)
    if name in MAPPERS:
        return MAPPERS[name](settings)
    factory = load_plugin(name, "mapper")
    mapper: Mapper = made(factory, name, "mapper", (settings,), options or {}, MAPPER_PARTS)
    return mapper


def check_mapper(name: str, options: Mapping[str, Any] | None = None) -> None:
    """Refuse a name that is neither of `MAPPERS` nor a user's own.

    Raises:
        ConfigError: It is neither, or a known one is given options.
    """
    check_name("mapper", name, MAPPERS, options)


def map_into(mapper: Mapper, voxels: VoxelMap) -> None:
    """Have a mapper that has mapped nothing yet use a map that is kept elsewhere.

    Raises:
        ConfigError: It keeps more than its map, in memory.
    """
    if mapper.name in _INSIDE:
        raise ConfigError(
            f"mapper {mapper.name!r} keeps more than its map, in memory; leave --memory out, or "
            "give --mapper bayes"
        )
    mapper.voxels = voxels
    if mapper.voxels is not voxels:
        raise ConfigError(
            f"mapper {mapper.name!r} cannot be given a map (its voxels cannot be set); leave "
            "--memory out"
        )


_GROWTH = 3
"""Memory at a moment when the map's arrays double: the old ones and the new."""


def bytes_per_voxel(name: str, settings: MappingSettings) -> int:
    """What a voxel of a growing map takes at most, with what its mapper keeps for it."""
    kept = _INSIDE[name](settings) if name in _INSIDE else 0
    return BYTES_PER_VOXEL * (1 + kept) * _GROWTH
