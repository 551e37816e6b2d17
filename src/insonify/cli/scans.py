"""Scanning an object."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import console, say, say_json, say_table, tell
from insonify.cli.progress import Bar, begin, progress
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    Interrupted,
    JsonOption,
    MapperOption,
    ModelOption,
    OutOption,
    PlannerOption,
    RendererOption,
    SetOption,
    absolute,
    app,
    choices,
    configure,
    interruptible,
    print_report,
)
from insonify.cli.runs import folder_bytes, size_text
from insonify.cli.vehicles import (
    CurrentOption,
    NavigationOption,
    RealTimeOption,
    VehicleOption,
    check_vehicle,
    vehicle_table,
    wall_clock,
)
from insonify.errors import ConfigError
from insonify.names import file_name

if TYPE_CHECKING:
    from insonify.config.settings import Table
    from insonify.mission.loop import Step
    from insonify.mission.result import ScanResult
    from insonify.mission.run import Run
    from insonify.mission.setup import Config


_ENDING = (
    "ending the scan here, and scoring it; the same command goes on later (Ctrl-C again: stop at "
    "once, and go on later too)"
)
_WIDE = 74
"""Characters that all scores take; in fewer, those from F2 on are left out."""


@app.command()
def scan(
    scenario: Annotated[
        str | None, typer.Argument(help="Name of a scenario; see: scenarios")
    ] = None,
    planner: PlannerOption = None,
    mapper: MapperOption = None,
    object_: Annotated[
        Path | None, typer.Option("--object", metavar="MESH", help="Scan this mesh file instead.")
    ] = None,
    sonar: Annotated[str | None, typer.Option(help="Scan with this device; see: sonars")] = None,
    renderer: RendererOption = None,
    model: ModelOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the seabed and the noise.")] = None,
    vehicle: VehicleOption = None,
    current: CurrentOption = None,
    navigation: NavigationOption = None,
    real_time: RealTimeOption = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the scan in the browser while it runs.")
    ] = False,
    live_bus: Annotated[
        bool,
        typer.Option("--live-bus", help="Ping on the robot's bus, and scan where `live` says."),
    ] = False,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Scan an object, decide where to scan next until it no longer pays, and report."""
    begin("starting")
    chosen = choices(
        planner=absolute(planner),
        mapper=absolute(mapper),
        seed=seed,
        sonar=absolute(sonar),
        renderer=renderer,
        model=model,
        object=_mesh_table(object_),
        vehicle=vehicle_table(vehicle, current, navigation),
    )
    full = configure(scenario, config, settings, chosen)
    check_vehicle(full, current=current, navigation=navigation, real_time=real_time)
    pace = wall_clock() if real_time else lambda time_s: None
    if live_bus:
        _scan_on_bus(full, out, force=force, as_json=as_json)
        return
    _scan(full, out, force=force, live=live, as_json=as_json, pace=pace)


def _scan_on_bus(config: Config, out: Path | None, *, force: bool, as_json: bool) -> None:
    """Scan as a vehicle on the bus, which pings in real time and flies what comes."""
    from insonify.io.folders import unused_folder
    from insonify.live.bus import Bus
    from insonify.live.robot import ScanRobot
    from insonify.mission.setup import World
    from insonify.results.scan import run_scan_by

    area = World(config).area
    name = file_name(f"{config.scenario}-bus-seed{config.seed}")
    folder = out or unused_folder(Path("insonify-runs") / name)
    with Bus() as bus, interruptible() as interrupted, progress("setting up") as bar:
        robot = ScanRobot(bus, area, interrupted)
        tell(f"insonify: pinging in DDS domain {bus.domain} once somebody listens", flush=True)
        robot.await_listener()
        result, target = run_scan_by(
            robot, config, folder, force=force, watch=_each(steps_on(bar), robot.watch),
            should_stop=interrupted, pace=robot.pace,
        )  # fmt: skip
    if as_json:
        say_json(result.to_json())
    else:
        print_result(result)
    print_report(target)
    if interrupted():
        raise typer.Exit(EXIT_INTERRUPTED)


def _scan(
    config: Config,
    out: Path | None,
    *,
    force: bool,
    live: bool,
    as_json: bool,
    pace: Callable[[float], None],
) -> None:
    from insonify.cli.views import live_page, serve
    from insonify.results.scan import place_for, run_scan

    name = file_name(f"{config.scenario}-{_short(config.planner)}-seed{config.seed}")
    folder = out or place_for(config, Path("insonify-runs") / name)
    page = live_page(name) if live else None
    with interruptible(_ENDING) as interrupted, progress("setting up") as bar:
        watch = _each(steps_on(bar), *([page.watch] if page else []))
        try:
            result, target = run_scan(
                config, folder, force=force, watch=watch, phase=partial(bar.restart, total=None),
                should_stop=interrupted, pace=pace,
            )  # fmt: skip
        except Interrupted as err:
            tell("insonify: stopped; the same command goes on after the pings that are recorded")
            raise typer.Exit(EXIT_INTERRUPTED) from err
    if as_json:
        say_json(result.to_json())
    else:
        print_result(result)
    print_report(target)
    if out is None:
        size = size_text(folder_bytes(target))
        tell(
            f"insonify: {target} takes {size}; `insonify runs` lists them, and clears repeated ones"
        )
    if interrupted():
        tell("insonify: interrupted; this is what was scanned until then, and the same command "
             "goes on")  # fmt: skip
        raise typer.Exit(EXIT_INTERRUPTED)
    if page is not None:
        tell("insonify: the view stays open until Ctrl-C")
        serve(page)


def _short(planner: str) -> str:
    """The name of a planner as a part of a folder's name."""
    return planner.rpartition(":")[2]


def _mesh_table(mesh: Path | None) -> Table | None:
    """As a setting; absolute, so that the saved config runs from any folder."""
    if mesh is None:
        return None
    if not mesh.name:
        raise ConfigError(f"--object takes a mesh file, not {str(mesh)!r}")
    return {"mesh": str(mesh.absolute())}


def _each(*consumers: Callable[[Run, Step], None]) -> Callable[[Run, Step], None]:
    """Several consumers of a run's steps as one."""

    def watch(run: Run, step: Step) -> None:
        for consumer in consumers:
            consumer(run, step)

    return watch


def steps_on(bar: Bar) -> Callable[[Run, Step], None]:
    """What shows the steps of one run after another on a bar."""
    from insonify.mission.loop import Decided, Mapped, Scanned

    def watch(run: Run, step: Step) -> None:
        title = f"{run.config.scenario} {run.planner}"
        if isinstance(step, Decided) and step.decision.path is not None:
            bar.restart(f"{title}, scan {len(run.paths) + 1}", len(step.decision.path.waypoints))
        elif isinstance(step, Mapped):
            done = len(run.paths[-1].waypoints)
            bar.show(done, note=f"{bar.rate(done):.0f} pings/s")
        elif isinstance(step, Scanned):
            bar.restart(f"{title}, deciding", None)

    return watch


def print_result(result: ScanResult) -> None:
    """A run's figures for people."""
    from rich.table import Table as RichTable

    title = (
        f"{result.scenario}, {result.planner} planner, seed {result.seed}: "
        f"{result.scans} scans, {result.pings} pings, {result.path_m:.1f} m"
    )
    heads = ["precision", "recall", "F1", "F2", "F3"]
    heads = heads[: 3 if console().width < _WIDE else None]
    table = RichTable("truth", "match", *heads, title=title)
    for kind, matches in result.metrics.items():
        for match, scores in matches.items():
            values = [f"{value:.3f}" for value in scores.values()]
            table.add_row(kind, match.replace("_", " "), *values[: len(heads)])
    say_table(table)
    if result.vehicle is not None:
        flown, error = result.vehicle, result.vehicle.pose_error
        perfect = flown.metrics_at_true_poses["solid"]["exact"]["f1"]
        say(
            f"{flown.name} flew {flown.time_s:.0f} s; its position was off by "
            f"{error['position_mean_m']:.2f} m in the mean, {error['position_max_m']:.2f} m at "
            f"most. Mapped at the true poses, solid F1 would be {perfect:.3f}."
        )
    say(result.why_stopped or result.stop_reason.sentence)
