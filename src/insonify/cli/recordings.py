"""What is in a recording, and maps from recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say_json, say_listing, tell
from insonify.cli.progress import begin, progress
from insonify.cli.reading import takes_reading
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    Interrupted,
    JsonOption,
    MapperOption,
    MemoryOption,
    SetOption,
    absolute,
    app,
    choices,
    file_layers,
    interruptible,
    memory_limit,
    print_report,
    single_layers,
)
from insonify.cli.words import pose_rows, summary_rows
from insonify.errors import ConfigError, GeometryError

if TYPE_CHECKING:
    from insonify.config.settings import Table
    from insonify.io.folders import ResultFolder
    from insonify.io.recordings.recording import Recording
    from insonify.mapping.mapper import Mapper
    from insonify.mission.remap import Remap, Watch
    from insonify.mission.result import MapResult
    from insonify.results.map import MapConfig
    from insonify.types import Box, PosedPing

VoxelOption = Annotated[
    float | None,
    typer.Option(metavar="M", help="Edge length of a voxel; 0.1 by default.", show_default=False),
]
ThresholdOption = Annotated[
    str | None,
    typer.Option(
        "--threshold",
        metavar="VALUE|auto",
        help="Pixels above are echoes, of 255; auto: as the recordings' own noise tells. Else "
        "mapping.pixel_threshold.",
    ),
]
RegionOption = Annotated[
    str | None,
    typer.Option(
        metavar="'X0 Y0 Z0 X1 Y1 Z1'",
        help="Where entropy counts; by default around what is occupied.",
    ),
]


@app.command()
@takes_reading
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: file or folder.")],
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Write its middle ping in fan view.")
    ] = None,
    reading: Any = None,
    as_json: JsonOption = False,
) -> None:
    """Say what is in a recording: ARIS, Oculus, arrays, images, bags."""
    begin("starting")
    from insonify.io.recordings import open_recording
    from insonify.io.recordings.poses import is_telemetry, read_poses
    from insonify.io.recordings.summary import summarise, summarise_poses

    if is_telemetry(file):
        told = summarise_poses(file, read_poses(file))
        if as_json:
            say_json(told)
        else:
            say_listing(["what", "value"], pose_rows(told))
        return
    summary, middle = summarise(open_recording(file, reading))
    if picture is not None and middle is not None:
        from insonify.io.folders import write_file
        from insonify.report.fans import AS_IT_IS, draw_fan

        title = f"{file.name}, ping {summary['pings'] // 2 + 1} of {summary['pings']}"
        write_file(picture, draw_fan(middle, title, scale=AS_IT_IS))
        tell(f"Picture: {picture}")
    if as_json:
        say_json(summary)
    else:
        say_listing(["what", "value"], summary_rows(summary))


@app.command("map")
@takes_reading
def map_(
    files: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="Recordings: files or folders.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")],
    mapper: MapperOption = None,
    voxel: VoxelOption = None,
    threshold: ThresholdOption = None,
    region: RegionOption = None,
    memory: MemoryOption = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Of a Dask cluster: each of its workers maps a part of the area.",
        ),
    ] = None,
    reading: Any = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace results in DIR.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Build an occupancy map, its entropy and a report from recordings."""
    begin("starting")
    from insonify.io.folders import result_folder
    from insonify.io.recordings import open_recording
    from insonify.mission.remap import echo_threshold, map_recordings
    from insonify.results.kept import kept_pings
    from insonify.results.map import save_remap

    box = box_from_text(region) if region is not None else None
    limit = memory_limit(memory)

    full = map_config(voxel, absolute(mapper), settings, config)
    if threshold is not None and threshold != "auto":
        full = _with_threshold(full, threshold)
    job = "" if limit is None or scheduler else _job(files, reading, full, threshold)
    with (
        result_folder(out, force=force, job=job, progress=kept_pings) as place,
        interruptible() as interrupted,
    ):
        recordings = [open_recording(file, reading) for file in files]
        if threshold == "auto":
            full = _with_threshold(full, str(echo_threshold(recordings)))
            tell(f"Threshold: {full.mapping.pixel_threshold} of 255")
        try:
            if scheduler is not None:
                how = (full, place.scratch, limit, scheduler, box)
                remap = _mapped_on_cluster(recordings, reading, *how, interrupted)
            else:
                mapper_used = _mapper_at(place, full, limit)
                with _progress() as watch:
                    remap = map_recordings(
                        recordings, full.mapping, box, mapper=mapper_used, watch=watch,
                        should_stop=interrupted,
                    )  # fmt: skip
        except Interrupted:
            place.kept = bool(job)
            raise
        with progress("writing the map and its report"):
            result = save_remap(remap, place.scratch, full)
    if as_json:
        say_json(result.to_json())
    else:
        say_listing(["what", "value"], map_rows(result))
    print_report(place.target)
    if interrupted():
        tell("insonify: interrupted; what was mapped until then is kept")
        raise typer.Exit(EXIT_INTERRUPTED)


def _job(files: list[Path], reading: Any, full: MapConfig, threshold: str | None) -> str:
    """All that decides what a map on disk is, so that the same command goes on after a kill."""
    stamps = [
        (str(file.absolute()), file.stat().st_mtime_ns if file.exists() else 0) for file in files
    ]
    return repr([full.model_dump(), threshold, reading, stamps])


def _mapper_at(place: ResultFolder, full: MapConfig, limit: int | None) -> Mapper:
    """The mapper of a result; of one on disk, which goes on with what a killed process left."""
    from insonify.io.maps.ondisk import TileStore, take_over
    from insonify.results.kept import KeptMapper, kept_pings
    from insonify.results.map import MAP, mapper_for

    if place.before is not None:
        take_over(place.before / MAP, place.scratch / MAP)
        tell(f"insonify: going on after {kept_pings(place.scratch)} pings that are mapped already")
    mapper = mapper_for(full, place.scratch, limit)
    store = mapper.voxels.store
    return KeptMapper(mapper, store) if isinstance(store, TileStore) else mapper


def _mapped_on_cluster(
    recordings: list[Recording],
    reading: Any,
    full: MapConfig,
    folder: Path,
    limit: int | None,
    scheduler: str,
    region: Box | None,
    interrupted: Callable[[], bool],
) -> Remap:
    """The map of recordings, made by the workers of a Dask cluster."""
    from insonify.mission.tiling import MEMORY_BYTES, Order, map_on_cluster

    files = tuple(recording.path.absolute() for recording in recordings)
    how = (full.mapper, full.mapping, full.mapper_options)
    order = Order(files, reading, *how, folder.absolute() / "map.zarr", limit or MEMORY_BYTES)
    with _progress() as watch, progress("parts") as bar:
        remap = map_on_cluster(
            order, recordings, scheduler, region, watch=watch,
            told=lambda done, count: bar.show(done, count, note=f"{done} of {count}"),
            should_stop=interrupted,
        )  # fmt: skip
    if remap is None:
        tell("insonify: interrupted; nothing is kept of a map on a cluster")
        raise typer.Exit(EXIT_INTERRUPTED)
    return remap


def map_config(
    voxel_m: float | None,
    mapper: str | None,
    settings: list[str] | None,
    config: Path | None = None,
) -> MapConfig:
    """How recordings are mapped: file, then --voxel and --mapper, then --set mapping.KEY=VALUE.

    The file may be a scan's too; what is of its other rooms does not matter here.
    """
    from insonify.config.layers import overlaid
    from insonify.config.settings import validated
    from insonify.mapping.factory import check_mapper
    from insonify.results.map import MapConfig

    known = set(MapConfig.model_fields)
    from_file = [_without_a_scans(layer, known) for layer in file_layers(config)]
    chosen = choices(mapper=mapper, mapping=choices(voxel_m=voxel_m) or None)
    single = single_layers(settings)
    for layer in single:
        if not set(layer) <= known or not all(isinstance(v, dict | str) for v in layer.values()):
            raise ConfigError(
                "recordings are mapped with --set mapping.KEY=VALUE and mapper_options.KEY=VALUE, "
                f"not {next(iter(layer))}"
            )
    see = "`insonify config --for map`"
    full = validated(MapConfig, overlaid([*from_file, chosen, *single]), see=see)
    check_mapper(full.mapper, full.mapper_options)
    return full


def _with_threshold(full: MapConfig, text: str) -> MapConfig:
    from insonify.config.layers import overlaid
    from insonify.config.settings import validated

    try:
        value = int(text)
    except ValueError as err:
        raise ConfigError(
            f"--threshold takes a whole number up to 255, or auto, not {text!r}"
        ) from err
    told = overlaid([full.model_dump(), {"mapping": {"pixel_threshold": value}}])
    return validated(type(full), told, see="`insonify config --for map`")


def _without_a_scans(layer: Table, known: set[str]) -> Table:
    """A file's settings but those that only a scan has."""
    from insonify.mission.setup import Config

    others = set(Config.model_fields) - known
    return {key: value for key, value in layer.items() if key not in others}


def box_from_text(text: str) -> Box:
    """The box of a --region.

    Raises:
        GeometryError: It is not six numbers, the low corner first.
    """
    from insonify.types import Box

    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
        x0, y0, z0, x1, y1, z1 = numbers
    except ValueError as err:
        raise GeometryError(
            f"--region takes six numbers in metres, as in '-5 -5 -20 5 5 -15', not {text!r}"
        ) from err
    if not (x0 < x1 and y0 < y1 and z0 < z1) or max(map(abs, numbers)) > 1e9:
        raise GeometryError(f"--region {text!r}: its second corner must lie above its first")
    return Box((x0, y0, z0), (x1, y1, z1))


@contextmanager
def _progress() -> Iterator[Watch]:
    """A progress bar over the pings of one recording after another."""
    with progress("opening") as bar:

        def watch(remap: Remap, recording: Recording, number: int, posed: PosedPing) -> None:
            note = f"{number} of {recording.count}"
            bar.show(number, recording.count, recording.path.name, note)

        yield watch


def map_rows(result: MapResult) -> list[list[str]]:
    """A map's figures for people."""
    low, high = ([f"{c:.2f}" for c in corner] for corner in result.region_m)
    region = result.region
    share = region["in_view"] / max(1, region["voxels"])
    return [
        *([source["file"], f"{source['mapped']} of {source['pings']} pings"]
          for source in result.recordings),
        ["voxel, m", f"{result.mapping['voxel_m']:g}"],
        ["occupied voxels", str(result.occupied_voxels)],
        ["region, m", f"({', '.join(low)}) to ({', '.join(high)})"],
        ["  in view", f"{share:.1%} of {region['voxels']:.0f} voxels"],
        ["  entropy, bits", f"{region['entropy_bits']:.0f}"],
        ["seconds", f"{sum(result.seconds.values()):.2f}"],
    ]  # fmt: skip
