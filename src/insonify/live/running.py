"""A session from its first message to the folder that it leaves."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from insonify.io.folders import ResultFolder, result_folder
from insonify.live.health import Pulse
from insonify.live.keeping import Keeper, kept_bytes, remember, take_over
from insonify.live.leaving import save_session
from insonify.live.played import Source
from insonify.live.poser import Poser
from insonify.live.session import Session, Watcher, follow
from insonify.mapping.factory import MAPPERS, make_mapper
from insonify.mapping.mapper import check_voxels
from insonify.mission.remap import Remap
from insonify.mission.result import MapResult
from insonify.results.map import MapConfig, mapper_for
from insonify.types import Box, FanGeometry, Ping, Pose

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """What is to be done, and where to leave it.

    Attributes:
        config: How pings are mapped.
        region: Where entropy is counted; by default around what is occupied.
        target: The folder.
        force: Replace the results in it.
        memory_bytes: What the map's blocks may take in memory, the others being on disk; by
            default all are in memory.
        job: What the next start must have in common with one that was killed to go on with its
            pings; nothing if none shall.
    """

    config: MapConfig
    region: Box | None
    target: Path
    force: bool = False
    memory_bytes: int | None = None
    job: str = ""


def run_session(
    order: Order,
    poser: Poser,
    source: Source,
    watchers: Iterable[Watcher] = (),
    should_stop: Callable[[], bool] = lambda: False,
) -> tuple[MapResult | None, Path]:
    """Map what a source gives until it ends, and leave a folder.

    What was recorded before a fault is kept for the next start with the same order.

    Returns:
        The figures, None if nothing was mapped; and the folder, which is there if any ping came.

    Raises:
        OutputError: The folder exists, or cannot be written.
        InsonifyError: Something is the user's to say.
    """
    config = order.config
    with result_folder(
        order.target, force=order.force, job=order.job, progress=kept_bytes
    ) as place:
        if place.before is not None:
            take_over(place.before, place.scratch)
        remap = Remap(config.mapping, mapper_for(config, place.scratch, order.memory_bytes))
        check_voxels(remap.mapper, config.mapping)
        keeper = _keeper(place, remap)
        session = Session(poser, remap, [keeper.watch, Pulse(place.scratch).watch, *watchers])
        try:
            follow(session, source, should_stop)
            if not keeper.parts:
                return None, place.target
            result = save_session(
                session, keeper, place.scratch, place.target, config, order.region
            )
        except BaseException:
            place.kept = bool(order.job and keeper.parts)
            keeper.abandon()
            raise
    return result, place.target


def load_kernels(config: MapConfig) -> None:
    """Have the mapper's kernels loaded before the first ping, which would wait for them.

    A user's own mapper is left alone: what it does with a ping is its own.
    """
    if config.mapper not in MAPPERS:
        return
    mapper = make_mapper(config.mapper, config.mapping)
    reach_m = 8 * config.mapping.voxel_m
    fan = FanGeometry(0.5, 0.2, 4, 16, 0.0, reach_m)
    image = np.zeros((16, 4), np.float32)
    image[8] = 1.0
    fixed = image.copy()
    fixed.setflags(write=False)  # as pixels of the bus may be
    for pixels in (image, fixed):
        mapper.integrate(Ping(pixels, fan), Pose(0.0, 0.0, 0.0))
    (mapper.voxels.log_odds > 0.0).any()


def _keeper(place: ResultFolder, remap: Remap) -> Keeper:
    """Who keeps the session's pings, after what an earlier start has kept."""
    if place.before is None:
        return Keeper(place.scratch)
    parts = remember(remap, place.scratch)
    _log.info("going on after %d pings of a session that ended unasked", _pings(parts))
    return Keeper(place.scratch, parts)


def _pings(parts: Iterable[dict[str, Any]]) -> int:
    return sum(int(part["pings"]) for part in parts)
