"""Flying a vehicle with several sonars over a world."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import say, say_json, tell
from insonify.cli.progress import begin, progress
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    MaterialsOption,
    OutOption,
    RangeOption,
    SearchOption,
    SetOption,
    absolute,
    app,
    choices,
    file_layers,
    interruptible,
    single_layers,
    world_table,
)
from insonify.cli.simulation import McapOption, write_mcap
from insonify.cli.vehicles import (
    CurrentOption,
    NavigationOption,
    RealTimeOption,
    VehicleOption,
    vehicle_table,
    wall_clock,
)
from insonify.errors import ConfigError
from insonify.names import file_name

if TYPE_CHECKING:
    from insonify.cli.progress import Bar
    from insonify.imaging.tour import Tour, TourPing
    from insonify.live.robot import TourRobot
    from insonify.results.tour import TourWriter
    from insonify.scene import Scene
    from insonify.types import StopReason
    from insonify.vehicle.craft import Craft


@app.command()
def fly(
    world: Annotated[
        str | None, typer.Argument(help="SDF world or model, mesh file, scenario, or tank, grid...")
    ] = None,
    waypoints: Annotated[
        str | None,
        typer.Option(metavar="'X Y Z HEADING; ...'", help="Metres, degrees; the first: the start."),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Waypoints from CSV with x_m, y_m, z_m, yaw_deg."),
    ] = None,
    vehicle: VehicleOption = None,
    current: CurrentOption = None,
    navigation: NavigationOption = None,
    sonars: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="flatfish, or a TOML file with [\\[sonars]]."),
    ] = None,
    range_m: RangeOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of sensors and images.")] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="On the robot's bus: ping there, then fly the paths of `live`."
        ),
    ] = False,
    search: SearchOption = None,
    materials: MaterialsOption = None,
    real_time: RealTimeOption = False,
    mcap: McapOption = False,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Fly a vehicle with several sonars over a world; each pings on its own clock."""
    from insonify.imaging.tour import tour_config

    begin("starting")
    chosen = choices(
        world=absolute(world),
        seed=seed,
        sonars=absolute(sonars),
        vehicle=vehicle_table(vehicle, current, navigation),
        waypoints=_waypoints(waypoints, path),
    ) | world_table(search, materials)
    full = tour_config([*file_layers(config), chosen, *single_layers(settings)], range_m)
    if live:
        from insonify.live.bus import Bus
        from insonify.live.robot import TourRobot

        frequency_hz = {one.name: 1e3 * one.sonar.frequency_khz for one in full.sonars}
        with Bus() as bus:
            robot = TourRobot(bus, full.vehicle, frequency_hz)
            _fly(full, out, force=force, mcap=mcap, as_json=as_json, robot=robot, pace=robot.pace)
        return
    pace = wall_clock() if real_time else lambda time_s: None
    _fly(full, out, force=force, mcap=mcap, as_json=as_json, pace=pace)


def _fly(
    config: Tour,
    out: Path | None,
    *,
    force: bool,
    mcap: bool,
    as_json: bool,
    pace: Callable[[float], None],
    robot: TourRobot | None = None,
) -> None:
    from insonify.io.folders import result_folder, unused_folder
    from insonify.results.tour import TourWriter

    scene = config.scene()
    folder = out or unused_folder(Path("insonify-runs") / file_name(f"fly-{config.world_name}"))
    with (
        result_folder(folder, force=force) as place,
        interruptible() as interrupted,
        TourWriter(config, place.scratch) as writer,
        progress("flying") as bar,
    ):
        records = _records(config, scene, pace, robot, interrupted)
        craft, reason = _flown(records, writer, bar, interrupted)
        bar.show(name="writing")
        result = writer.finish(craft, reason)
        if mcap:
            devices = {one.name: one.sonar for one in config.sonars if result.pings[one.name]}
            write_mcap(devices, config.water, place.scratch, flown=True)
    if as_json:
        say_json(result.to_json())
    else:
        for name, count in result.pings.items():
            say(f"{name}: {count} pings")
        say(f"{result.path_m:.1f} m in {result.time_s:.1f} s. {result.stop_reason.sentence}")
    tell(f"Images and poses: {place.target}")
    if interrupted():
        tell("insonify: interrupted; what was heard until then is kept")
        raise typer.Exit(EXIT_INTERRUPTED)


def _records(
    config: Tour,
    scene: Scene,
    pace: Callable[[float], None],
    robot: TourRobot | None,
    interrupted: Callable[[], bool],
) -> Iterator[TourPing | Craft | StopReason]:
    """The tour; of a robot, published as it is flown."""
    from insonify.imaging.tour import TourPing, tour
    from insonify.types import StopReason

    if robot is None:
        yield from tour(config, scene, pace)
        return
    sonar = f"/{config.sonars[0].name}/image"
    tell(f"insonify: flying once somebody listens to {sonar}", flush=True)
    robot.orders.await_listener(robot.topics, sonar, interrupted)
    for record in tour(config, scene, pace, robot.order):
        if isinstance(record, TourPing):
            robot.publish(record)
        elif not isinstance(record, StopReason):
            robot.craft = record
        yield record


def _flown(
    records: Iterator[TourPing | Craft | StopReason],
    writer: TourWriter,
    bar: Bar,
    interrupted: Callable[[], bool],
) -> tuple[Craft, StopReason]:
    """The vehicle at the end of a tour, and why it ended; its pings are written as they come."""
    from insonify.imaging.tour import TourPing
    from insonify.types import StopReason

    craft: Craft | None = None
    for record in records:
        if isinstance(record, StopReason):
            assert craft is not None
            return craft, record
        if isinstance(record, TourPing):
            writer.write(record)
            bar.tell(f"{record.posed.ping.time_s:.0f} s")
        else:
            craft = record
        if interrupted():
            break
    assert craft is not None
    return craft, StopReason.INTERRUPTED


def _waypoints(text: str | None, path: Path | None) -> list[list[float]] | None:
    if text is not None and path is not None:
        raise ConfigError("give --waypoints or --path, not both")
    if path is not None:
        from insonify.io.routes import read_route

        return [[*row[1:4], row[6]] for row in read_route(path).rows]
    if text is None:
        return None
    rows = []
    for part in text.split(";"):
        try:
            row = [float(word) for word in part.replace(",", " ").split()]
        except ValueError:
            row = []
        if len(row) not in (3, 4) or not all(map(math.isfinite, row)):
            raise ConfigError(
                f"--waypoints takes x, y, z and heading, rows parted by ';', not {part.strip()!r}"
            )
        rows.append(row if len(row) == 4 else [*row, 0.0])
    return rows
