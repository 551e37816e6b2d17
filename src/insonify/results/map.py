"""What ``map`` leaves: figures, map, entropy, the sonar, a report."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from insonify.config.layers import read_layer
from insonify.config.settings import Settings, validated
from insonify.config.toml import to_toml
from insonify.errors import MemoryLimitError, MissingExtraError, ResultError
from insonify.io.folders import RESULT
from insonify.io.maps import load_map, save_map, save_point_cloud
from insonify.io.maps.ondisk import TileStore
from insonify.mapping.factory import make_mapper, map_into
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.mapping.voxels import MOST_DENSE, VoxelMap
from insonify.mission.remap import Remap
from insonify.mission.result import MapResult
from insonify.planning.active import EntropySettings
from insonify.planning.entropy import entropy_map
from insonify.results.files import CONFIG, load_result, save_result
from insonify.results.mappers import give_back, load_state, save_mapper
from insonify.sonar.devices import device_of

MAP = "map.zarr"
"""Of a map that is kept on disk."""
_log = logging.getLogger(__name__)


class MapConfig(Settings):
    """How recordings are mapped."""

    mapper: str = "bayes"
    mapping: MappingSettings = MappingSettings()
    mapper_options: dict[str, Any] = Field({}, description="of a mapper of your own")


def mapper_for(config: MapConfig, folder: Path, memory_bytes: int | None = None) -> Mapper:
    """A mapper with an empty map, in memory or in a result's folder.

    Args:
        config: How it maps.
        folder: Which exists.
        memory_bytes: What the map's blocks may take in memory; the others are in ``map.zarr``,
            also those that an earlier mapper wrote there, if the store is told of them.

    Raises:
        ConfigError: It cannot be had, or keeps more than its map.
        MemoryLimitError: The memory is too little.
        MissingExtraError: The package zarr is not installed.
    """
    mapper = make_mapper(config.mapper, config.mapping, config.mapper_options)
    if memory_bytes is not None:
        store = TileStore.new(folder / MAP, memory_bytes)
        map_into(mapper, VoxelMap(config.mapping.voxel_m, store))
    return mapper


def save_remap(remap: Remap, folder: Path, config: MapConfig) -> MapResult:
    """Write a map made of recordings into a folder that exists.

    ``entropy.npz`` holds the region: ``entropy_bits`` and ``seen`` (nx, ny, nz), ``low_m`` (3,) of
    its first voxel's corner, ``voxel_m``.
    """
    voxels, result = remap.mapper.voxels, remap.result()
    save_result(result, folder)
    (folder / CONFIG).write_text(to_toml(config, "How this map was made"), encoding="utf-8")
    if isinstance(voxels.store, TileStore):
        voxels.store.settle(voxels.voxel_m, voxels.origin_m)
    else:
        save_map(voxels, folder / "map.npz")
    save_mapper(remap.mapper, folder)
    try:
        save_point_cloud(voxels, folder / "map.ply", EntropySettings().high_entropy, remap.region)
    except MemoryLimitError as err:
        _log.warning("no map.ply is written: %s", err)
    _save_entropy(remap, folder / "entropy.npz")
    device = device_of(remap.fans[0], "recorded")
    (folder / "sonar.toml").write_text(to_toml(device), encoding="utf-8")
    _report(remap, folder / "report.html")
    return result


def _save_entropy(remap: Remap, path: Path) -> None:
    voxels = remap.mapper.voxels
    window = voxels.overview(remap.region)
    if window.voxel_m > voxels.voxel_m:
        _log.warning(
            "no entropy.npz is written: the region has more than %d voxels; give a smaller one "
            "(--region)", MOST_DENSE,
        )  # fmt: skip
        return
    low_m = np.array(window.first) * window.voxel_m + voxels.origin_m
    np.savez_compressed(
        path,
        entropy_bits=entropy_map(window),
        seen=window.seen,
        low_m=low_m,
        voxel_m=window.voxel_m,
    )


def _report(remap: Remap, path: Path) -> None:
    """The report; without the packages for it a map is whole too, and its log says what lacks."""
    try:
        from insonify.report.map_html import write_map_report
    except MissingExtraError as err:
        _log.warning("no report is written: %s", err)
    else:
        write_map_report(remap, path)


def load_mapper(path: Path | str, memory_bytes: int | None = None) -> Mapper:
    """A mapper with the map of a result of ``scan`` or ``map``, ready to go on or to be asked.

    Args:
        path: The result's folder, or a map file; beside it the config says what mapper made it.
            A map on its own is taken for one of `bayes`.
        memory_bytes: As in `load_map`.

    Raises:
        MapFileError: The map cannot be read.
        ConfigError: Its mapper cannot be had.
        ResultError: It was made by another mapper than its config names.
    """
    path = Path(path)
    voxels = load_map(path, memory_bytes=memory_bytes)
    folder = path if path.is_dir() and path.suffix != ".zarr" else path.parent
    mapper = empty_mapper(folder, voxels.voxel_m)
    give_back(mapper, voxels, load_state(mapper, folder))
    return mapper


def empty_mapper(folder: Path, voxel_m: float) -> Mapper:
    """A mapper as the one that made the map in a result's folder, with an empty map.

    Args:
        folder: Of the result; without a config in it, of `bayes`.
        voxel_m: Edge length of the map's voxels.

    Raises:
        ConfigError: The mapper cannot be had.
        ResultError: The map was made by another than its config names.
    """
    config = config_of(folder) if (folder / CONFIG).is_file() else MapConfig()
    settings = config.mapping.model_copy(update={"voxel_m": voxel_m})
    mapper = make_mapper(config.mapper, settings, config.mapper_options)
    made_by = getattr(load_result(folder), "mapper", None) if (folder / RESULT).is_file() else None
    if made_by not in (None, mapper.name):
        raise ResultError(
            f"{folder / CONFIG}: names mapper {config.mapper!r}, and the map was made by "
            f"{made_by!r}; name the one that made it"
        )
    return mapper


def config_of(folder: Path) -> MapConfig:
    """How the map in a result's folder was made.

    Raises:
        ConfigError: Its config cannot be read.
    """
    table = read_layer(folder / CONFIG)
    known = {key: table[key] for key in MapConfig.model_fields if key in table}
    return validated(MapConfig, known, where=str(folder / CONFIG))
