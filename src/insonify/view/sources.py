"""Stories of what lies on the disk: a result folder, a map, or recordings; nothing is run again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from insonify.errors import ConfigError, InsonifyError, MapFileError, RecordingError
from insonify.io.maps import LOADED, load_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, Recording
from insonify.mapping.factory import MAPPERS, make_mapper
from insonify.mission.account import Account
from insonify.mission.explanation import differing
from insonify.mission.remap import Remap, map_recordings
from insonify.results.files import CONFIG, RECORDING
from insonify.results.map import MapConfig, config_of
from insonify.results.scan import is_scan, load_run
from insonify.types import Box, PosedPing
from insonify.view.story import Story, Thinned

_log = logging.getLogger(__name__)

MOST_PICTURES = 200
"""Of the map of a recording, whose length is known."""


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """A story at its beginning, and what tells the rest of it.

    Attributes:
        story: What can be shown at once.
        count: How many pings there are to come.
        go_on: Reads on until the end; may run while the page is open.  It is asked whether to stop
            with every ping, and says how many there are done and in all.
    """

    story: Story
    count: int
    go_on: Callable[[Callable[[int, int], None], Callable[[], bool]], None]


def open_story(
    path: Path,
    reading: Reading,
    config: MapConfig,
    region: Box | None = None,
    memory_bytes: int | None = None,
) -> Told:
    """The story of a run's folder, a map, or a recording.

    Args:
        path: A result folder of ``scan`` or ``map``, a map that can be read, or a recording.
        reading: What the user says of a recording.
        config: How a recording is mapped; a run that was broken off is mapped by its own.
        region: Where uncertainty counts; by default the run's own, or around what is occupied.
        memory_bytes: Of a ``.zarr`` map, as in `load_map`.

    Raises:
        InsonifyError: It is none of these, or damaged.
    """
    holds_map = any((path / name).exists() for name in ("map.npz", "map.zarr"))
    holds_map |= path.suffix in LOADED and _is_map(path)
    if memory_bytes is not None and (is_scan(path) or not holds_map):
        raise ConfigError(f"{path}: --memory is for maps (.zarr), not for runs and recordings")
    if is_scan(path):
        return _scan_story(path)
    how: MapConfig | None = config
    if (path / RECORDING).is_file() and (path / CONFIG).is_file():  # broken off, or an older one
        how, path = _config_again(path), path / RECORDING
    if holds_map:
        story = map_story(path, region, memory_bytes)
        return Told(story, 0, lambda watch, should_stop: None)
    recording = open_recording(path, reading)
    story = Story(path.resolve().name)
    return Told(
        story,
        recording.count,
        lambda watch, should_stop: _tell_recording(
            story, recording, how, region, watch, should_stop
        ),
    )


def map_story(path: Path, region: Box | None = None, memory_bytes: int | None = None) -> Story:
    """A map alone.

    Raises:
        MapFileError: It cannot be read.
    """
    voxels = load_map(path, memory_bytes=memory_bytes)
    story = Story(path.resolve().name)
    if region is not None:
        region = region.relative_to(voxels.origin_m)
    story.add_map(voxels, region or voxels.around_occupied())
    return story


def _scan_story(folder: Path) -> Told:
    """A run as its files tell it: decisions and truth at once, its pings as they are read."""
    account = load_run(folder)
    result = account.result
    story = Story(f"{result.scenario}, {result.planner} planner, seed {result.seed}")
    story.world, story.region = account.solids, account.region
    story.end = result.why_stopped or result.stop_reason.sentence
    story.decisions = [(record.pings, record.decision) for record in account.decisions]
    return Told(
        story,
        result.pings,
        lambda watch, should_stop: _tell_scan(story, account, folder, watch, should_stop),
    )


def _tell_scan(
    story: Story,
    account: Account,
    folder: Path,
    watch: Callable[[int, int], None],
    should_stop: Callable[[], bool],
) -> None:
    """Read a run's pings, and map them as its mapper did, so that the map can be seen to grow.

    Where that mapper is not one of ours, or maps otherwise today, the map is shown as it was saved.
    """
    if not (folder / RECORDING).is_file():
        _log.warning("%s: the run was not recorded, so its map is shown without pings", folder)
        story.add_map(account.voxels, account.region)
        story.changed()
        return
    recording = open_recording(folder / RECORDING)
    how = _config_again(folder)
    mapper = None if how is None else make_mapper(how.mapper, how.mapping)
    story.maps = Thinned(stride=1 + recording.count // MOST_PICTURES)
    before = 1
    for number, (scan, posed) in enumerate(_by_scan(account, recording), 1):
        story.add_ping(posed, scan)
        story.changed()  # its image can be looked at while it is mapped
        if mapper is not None and posed.pose is not None:
            if scan > before:
                mapper.finish_scan()
            mapper.integrate(posed.ping, posed.pose)
            before = scan
        if mapper is not None and story.maps.wants(number) and number < recording.count:
            story.add_map(mapper.voxels, account.region)
        story.changed()
        watch(number, recording.count)
        if should_stop():
            return
    if mapper is not None:
        mapper.finish_scan()
        if differing(mapper.voxels, account.voxels):
            story.maps = Thinned()
    story.add_map(account.voxels, account.region)
    story.changed()


def _by_scan(account: Account, recording: Recording) -> Iterator[tuple[int, PosedPing]]:
    """The pings of a run's recording with the number of their scan."""
    scans = [
        number for number, path in enumerate(account.paths, 1) for _ in range(len(path.waypoints))
    ]
    for number, posed in enumerate(recording):
        yield (scans[number] if number < len(scans) else len(account.paths)), posed


def _config_again(folder: Path) -> MapConfig | None:
    """How a run's map was made, to make it again.

    None if that was by a mapper of a user's own, whose code is not run here, or if the settings are
    those of another version.
    """
    with suppress(InsonifyError):
        config = config_of(folder)
        if config.mapper in MAPPERS:
            return config
    _log.warning("%s: its mapper is not run here, so the map is not seen to grow", folder)
    return None


def _tell_recording(
    story: Story,
    recording: Recording,
    config: MapConfig | None,
    region: Box | None,
    watch: Callable[[int, int], None],
    should_stop: Callable[[], bool],
) -> None:
    """A recording, mapped as it goes; images alone if it has no poses or nothing says how.

    Raises:
        InsonifyError: There are no pings in it, or the map would not fit into memory.
    """
    story.maps = Thinned(stride=1 + recording.count // MOST_PICTURES)
    if config is None or recording.facts.get("poses", "none") == "none":
        for number, posed in enumerate(recording, 1):
            story.add_ping(posed)
            story.changed()
            watch(number, recording.count)
            if should_stop():
                return
        if not story.moments:
            raise RecordingError(f"{recording.path}: there are no pings in it")
        return

    def tell(remap: Remap, whence: Recording, number: int, posed: PosedPing) -> None:
        story.add_ping(posed)
        voxels = remap.mapper.voxels
        if voxels.block_count and story.maps.wants(number):
            shown = None if region is None else region.relative_to(voxels.origin_m)
            story.add_map(voxels, shown or voxels.around_occupied())
        story.changed()
        watch(number, recording.count)

    mapper = make_mapper(config.mapper, config.mapping, config.mapper_options)
    remap = map_recordings(
        [recording], config.mapping, region, mapper=mapper, watch=tell, should_stop=should_stop
    )
    story.add_map(remap.mapper.voxels, remap.region)
    story.changed()


def _is_map(path: Path) -> bool:
    """Whether a file of a map's suffix is one; archives of pings end in ``.npz`` too."""
    if path.suffix != ".npz":
        return True
    try:
        load_map(path)
    except MapFileError:
        return False
    return True
