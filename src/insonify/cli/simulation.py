"""Simulating a sonar in a world."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import say, say_json, say_table, tell
from insonify.cli.progress import begin, progress
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    MaterialsOption,
    ModelOption,
    OutOption,
    RangeOption,
    RendererOption,
    SearchOption,
    SetOption,
    absolute,
    app,
    choices,
    interruptible,
    numbers_of,
    with_range,
    world_and_layers,
    world_table,
)
from insonify.errors import ConfigError
from insonify.names import file_name

if TYPE_CHECKING:
    from insonify.config.settings import Table
    from insonify.imaging.route import Record, Simulation
    from insonify.mission.result import ImagesResult
    from insonify.sonar.devices import SonarDevice
    from insonify.sonar.water import WaterSettings


WorldArgument = Annotated[
    str | None,
    typer.Argument(
        help="SDF world or model, mesh file, scenario, or tank, grid, structures; or a named "
        "simulation: fls-tank, fls-grid, fls-structures, msis-tank, msis-turning, msis-structures."
    ),
]
McapOption = Annotated[
    bool, typer.Option("--mcap", help="Also a ROS 2 recording, pings.mcap, to replay elsewhere.")
]
PoseOption = Annotated[
    str | None,
    typer.Option(metavar="'X Y Z ROLL PITCH YAW'", help="Ping here: metres, degrees."),
]
PathOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Ping along these poses: CSV with x_m, ... or TUM."),
]
OrbitOption = Annotated[
    str | None,
    typer.Option(
        metavar="'X Y Z RADIUS COUNT PITCH'", help="Ping around x, y at height z, looking in."
    ),
]


@app.command()
def simulate(
    world: WorldArgument = None,
    sonar: Annotated[str | None, typer.Option(help="A device; see: sonars")] = None,
    pose: PoseOption = None,
    path: PathOption = None,
    orbit: OrbitOption = None,
    range_m: RangeOption = None,
    model: ModelOption = None,
    renderer: RendererOption = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="Label, elevation, range, point, shadow of each pixel.")
    ] = False,
    camera: Annotated[
        bool, typer.Option("--camera", help="A camera's picture beside each ping (OpenGL).")
    ] = False,
    mcap: McapOption = False,
    seed: Annotated[int | None, typer.Option(help="Seed of the noise.")] = None,
    search: SearchOption = None,
    materials: MaterialsOption = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a sonar in a world: images, arrays with their geometry, and their truth."""
    begin("starting")
    from insonify.imaging.route import simulation_config

    chosen = choices(sonar=absolute(sonar), model=model, renderer=renderer, seed=seed)
    chosen |= world_table(search, materials) | _route(pose, path, orbit)
    full = simulation_config(
        *world_and_layers(world, config, with_range(settings, range_m), chosen)
    )
    _simulate(full, out, force=force, truth=truth, camera=camera, mcap=mcap, as_json=as_json)


def _simulate(
    config: Simulation,
    out: Path | None,
    *,
    force: bool,
    truth: bool,
    camera: bool,
    mcap: bool,
    as_json: bool,
) -> None:
    from insonify.imaging.route import simulate as run
    from insonify.io.folders import result_folder, unused_folder
    from insonify.results.images import ImagesWriter
    from insonify.sonar.camera import Camera

    scene = config.scene()
    eye = Camera(config.camera) if camera else None
    name = file_name(f"{config.world_name}-{config.sonar.name}")
    folder = out or unused_folder(Path("insonify-runs") / name)
    with result_folder(folder, force=force) as place, interruptible() as interrupted:
        writer = ImagesWriter(config, scene.labels, place.scratch, truth=truth)
        with _progress(config) as watch:
            for record in run(config, scene, with_truth=truth, camera=eye):
                watch(record)
                writer.write(record)
                if interrupted():
                    break
        result = writer.finish()
        if mcap:
            write_mcap({"sonar": config.sonar}, config.water, place.scratch)
    if as_json:
        say_json(result.to_json())
    else:
        _print_result(result)
    tell(f"Results: {place.target}")
    if interrupted():
        raise typer.Exit(EXIT_INTERRUPTED)


def write_mcap(
    devices: Mapping[str, SonarDevice], water: WaterSettings, folder: Path, *, flown: bool = False
) -> None:
    """Write what sonars left in a result's folder as a recording beside it."""
    from insonify.io.recordings import open_recording
    from insonify.results.replay import PINGS, save_replay

    heard = {name: open_recording(folder / f"{name}.npz" if flown else folder) for name in devices}
    frequencies = {name: 1e3 * device.frequency_khz for name, device in devices.items()}
    save_replay(heard, folder / PINGS, frequencies, water.sound_speed_mps)


def _route(pose: str | None, path: Path | None, orbit: str | None) -> Table:
    """The one way in which the route is said, as a layer of settings."""
    if sum(way is not None for way in (pose, path, orbit)) > 1:
        raise ConfigError("give one of --pose, --path and --orbit, not several")
    if pose is not None:
        return {"route": [[0.0, *numbers_of("--pose", pose, 6)]], "timed": True}
    if path is not None:
        from insonify.io.routes import read_route

        route = read_route(path)
        return {"route": [list(row) for row in route.rows], "timed": route.timed}
    if orbit is not None:
        from insonify.imaging.route import orbit as rows_around

        x, y, z, radius, count, pitch = numbers_of("--orbit", orbit, 6)
        if count < 1 or count != int(count) or radius <= 0:
            raise ConfigError(f"--orbit needs a whole COUNT and a positive RADIUS, not {orbit!r}")
        rows = rows_around((x, y), z, radius, int(count), pitch)
        return {"route": [list(row) for row in rows], "timed": False}
    return {}


@contextmanager
def _progress(config: Simulation) -> Iterator[Callable[[Record], None]]:
    """A bar with the speed, beside the device's own."""
    from insonify.imaging.route import Turn, ping_times, turn_starts
    from insonify.sonar.devices import Kind

    scanning = config.sonar.kind is Kind.SCANNING
    total = len(turn_starts(config) if scanning else ping_times(config))
    own_hz = 1.0 / config.sonar.interval_s(config.water.sound_speed_mps)
    with progress(config.sonar.name, total) as bar:
        pings = records = 0

        def watch(record: Record) -> None:
            nonlocal pings, records
            records += 1
            pings += len(record.pings) if isinstance(record, Turn) else 1
            bar.show(records, note=f"{bar.rate(pings):.1f} pings/s (device: {own_hz:.1f})")

        yield watch


def _print_result(result: ImagesResult) -> None:
    from rich.table import Table as RichTable

    title = f"{result.world}: {result.sonar}, {result.model}, {result.renderer}"
    rows = result.pings
    with_truth = any("pixels" in row for row in rows)
    table = RichTable("time, s", "x, y, z, m", "roll, pitch, yaw, deg", title=title)
    if with_truth:
        table.add_column("pixels by label")
    for row in rows[:20]:
        cells = [
            f"{row['time_s']:.3f}",
            ", ".join(f"{value:.2f}" for value in row["position_m"]),
            ", ".join(f"{value:.1f}" for value in row["rpy_deg"]),
        ]
        if with_truth:
            counts = row["pixels"] | {"shadow": row["shadow_pixels"]}
            cells.append(", ".join(f"{name} {count}" for name, count in counts.items() if count))
        table.add_row(*cells)
    say_table(table)
    if len(rows) > 20:
        say(f"... and {len(rows) - 20} more pings")
