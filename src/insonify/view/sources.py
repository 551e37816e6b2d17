"""Stories of what lies on the disk: a result folder, a map, or recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from insonify.errors import ConfigError, MapFileError, RecordingError
from insonify.io.maps import LOADED, load_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, RecordedPing, Recording
from insonify.io.recordings.remembering import RECORDING, remembered
from insonify.io.unfinished import CONFIG
from insonify.mapping.bayes import MappingSettings
from insonify.mission import Mapped, Step
from insonify.replay import Replay, around_occupied, map_recordings
from insonify.runs import Run, execute
from insonify.scenarios import read_config, scenario_config
from insonify.types import Box
from insonify.view.story import Story, Thinned

MOST_PICTURES = 200
"""Of the map of a recording, whose length is known."""


def open_story(
    path: Path,
    reading: Reading,
    settings: MappingSettings,
    region: Box | None = None,
    *,
    watch: Callable[[str, int, int], None] = lambda name, done, count: None,
) -> Story:
    """The story of a run's folder, a map, or a recording.

    Args:
        path: A result folder of ``scan`` or ``map``, a map that can be read, or a recording.
        reading: What the user says of a recording.
        settings: How a recording is mapped.
        region: Where uncertainty counts; by default the run's own, or around what is occupied.
        watch: Called with what is read, how many pings of it are, and how many there are.

    Raises:
        InsonifyError: It is none of these, or damaged.
    """
    if (path / RECORDING).is_file() and (path / CONFIG).is_file():
        return run_story(path, watch=watch)
    if (path / "map.npz").is_file() or (path.suffix in LOADED and _is_map(path)):
        return map_story(path, region)
    return recording_story(open_recording(path, reading), settings, region, watch=watch)


def run_story(
    folder: Path, *, watch: Callable[[str, int, int], None] = lambda name, done, count: None
) -> Story:
    """A run lived through again from its recording: the same pings, so the same decisions.

    Raises:
        InsonifyError: The recording is damaged, or the run's world is no more.
    """
    layers = read_config(folder / CONFIG)
    if "scenario" not in layers:
        raise ConfigError(f"{folder / CONFIG}: does not name its scenario")
    config = scenario_config(str(layers["scenario"]), [layers, {"renderer": "embree"}])
    count, pings = remembered(folder)
    if not count:
        raise RecordingError(f"{folder / RECORDING}: there are no pings in it")
    story = Story(f"{config.scenario}, {config.planner} planner, seed {config.seed}")
    story.maps = Thinned(stride=1 + count // MOST_PICTURES)
    reached = 0

    def tell(run: Run, step: Step) -> None:
        nonlocal reached
        reached = run.pings
        if reached > count:  # a run that was broken off would go on here
            return
        story.watch(run, step)
        if reached == count and isinstance(step, Mapped):
            story.add_map(run.mapper.voxels, run.world.area.region)
        watch(folder.name, reached, count)

    execute(config, remembered=pings, watch=tell, should_stop=lambda: reached > count)
    return story


def map_story(path: Path, region: Box | None = None) -> Story:
    """A map alone.

    Raises:
        MapFileError: It cannot be read.
    """
    voxels = load_map(path)
    story = Story(path.resolve().name)
    story.add_map(voxels, region or around_occupied(voxels))
    return story


def recording_story(
    recording: Recording,
    settings: MappingSettings,
    region: Box | None = None,
    *,
    watch: Callable[[str, int, int], None] = lambda name, done, count: None,
) -> Story:
    """A recording, mapped as it goes; images alone if it has no poses.

    Raises:
        InsonifyError: There are no pings in it, or the map would not fit into memory.
    """
    story = Story(recording.path.name)
    story.maps = Thinned(stride=1 + recording.count // MOST_PICTURES)
    name, count = recording.path.name, recording.count
    if recording.facts.get("poses", "none") == "none":
        for number, recorded in enumerate(recording, 1):
            story.add_ping(recorded.ping, None)
            watch(name, number, count)
        if not story.moments:
            raise RecordingError(f"{recording.path}: there are no pings in it")
        return story

    def tell(replay: Replay, whence: Recording, number: int, recorded: RecordedPing) -> None:
        story.add_ping(recorded.ping, recorded.pose)
        voxels = replay.mapper.voxels
        if voxels.block_count and story.maps.wants(number):
            story.add_map(voxels, region or around_occupied(voxels))
        watch(name, number, count)

    replay = map_recordings([recording], settings, region, watch=tell)
    story.add_map(replay.mapper.voxels, replay.region)
    return story


def _is_map(path: Path) -> bool:
    """Whether a file of a map's suffix is one; archives of pings end in ``.npz`` too."""
    if path.suffix != ".npz":
        return True
    try:
        load_map(path)
    except MapFileError:
        return False
    return True
