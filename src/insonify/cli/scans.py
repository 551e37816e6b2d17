"""Scanning and comparing planners."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    OutOption,
    RendererOption,
    SetOption,
    app,
    choices,
    configure,
    file_layers,
    interruptible,
    single_layers,
    stderr,
)
from insonify.cli.vehicles import (
    CurrentOption,
    NavigationOption,
    RealTimeOption,
    VehicleOption,
    check_vehicle,
    print_navigation,
    vehicle_table,
    wall_clock,
)
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.mission import Step
    from insonify.runs import Run
    from insonify.scenarios import Table


@app.command()
def scan(
    scenario: Annotated[
        str | None, typer.Argument(help="Name of a scenario; see: scenarios")
    ] = None,
    planner: Annotated[
        str | None, typer.Option(help="entropy, uniform or lawnmower.", show_default=False)
    ] = None,
    object_: Annotated[
        Path | None, typer.Option("--object", metavar="MESH", help="Scan this mesh file instead.")
    ] = None,
    sonar: Annotated[str | None, typer.Option(help="Scan with this device; see: sonars")] = None,
    renderer: RendererOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the seabed and the noise.")] = None,
    vehicle: VehicleOption = None,
    current: CurrentOption = None,
    navigation: NavigationOption = None,
    real_time: RealTimeOption = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the scan in the browser while it runs.")
    ] = False,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Scan an object, decide where to scan next until it no longer pays, and report."""
    from insonify.cli.views import live_page, serve
    from insonify.io.configs import config_to_toml
    from insonify.io.folders import result_folder, unused_folder
    from insonify.io.recordings.remembering import RECORDING, remembered
    from insonify.io.recordings.scans import recording
    from insonify.io.unfinished import OWNER, claim, find_unfinished
    from insonify.runs import execute

    table = _mesh_table(object_)
    flown = vehicle_table(vehicle, current, navigation)
    chosen = choices(
        planner=planner, seed=seed, sonar=sonar, renderer=renderer, object=table, vehicle=flown
    )
    full = configure(scenario, config, settings, chosen)
    check_vehicle(full, current=current, navigation=navigation, real_time=real_time)
    pace = wall_clock() if real_time else lambda time_s: None
    name = f"{full.scenario}-{full.planner}-seed{full.seed}"
    folder = out or unused_folder(Path("insonify-runs") / name)
    before = find_unfinished(folder, config_to_toml(full), RECORDING)
    with result_folder(folder, force=force) as place, interruptible() as interrupted:
        claim(place.scratch, config_to_toml(full))
        known, past = remembered(before) if before is not None else (0, iter(()))
        if known:
            print(f"insonify: going on after the {known} pings of a scan that was broken off",
                  file=sys.stderr)  # fmt: skip
        page = live_page(name) if live else None
        with _progress() as show, recording(place.scratch) as record:
            run = execute(
                full,
                remembered=past,
                watch=_each(show, record, *([page.watch] if page else [])),
                should_stop=interrupted,
                pace=pace,
            )
        _write_results(run, place.scratch)
        (place.scratch / OWNER).unlink()
    if before is not None:
        shutil.rmtree(before, ignore_errors=True)
    result = run.result()
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        _print_result(result)
    print(f"Report: {place.target / 'report.html'}", file=sys.stderr)
    if interrupted():
        print("insonify: interrupted; what was scanned until then is kept", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED)
    if page is not None:
        print("insonify: the view stays open until Ctrl-C", file=sys.stderr)
        serve(page)


@app.command()
def compare(
    names: Annotated[list[str], typer.Argument(metavar="SCENARIO...", help="Scenarios.")],
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each planner, seeds from 0.")] = 5,
    vehicle: VehicleOption = None,
    current: CurrentOption = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the planners over seeds, beside the paper's Tables 2 and 3.

    With a vehicle: compare maps made by its own navigation with those of perfect navigation.
    """
    from insonify.comparison import compare as compare_planners
    from insonify.comparison import compare_navigation, summarise, summarise_navigation

    flown = vehicle_table(vehicle, current)
    if vehicle is None and current is not None:
        raise ConfigError("--current needs a vehicle to fly; add --vehicle bluerov2, for one")
    runs, summary = (
        (compare_planners, summarise)
        if vehicle is None
        else (compare_navigation, summarise_navigation)
    )
    with interruptible() as interrupted, _progress() as watch:
        layers = [*file_layers(config), choices(vehicle=flown), *_compared(settings, vehicle)]
        rows = runs(names, seeds, layers, watch=watch, should_stop=interrupted)
    table = summary(rows)
    if not rows:
        print("insonify: interrupted before the first run was complete", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED)
    if as_json:
        print(json.dumps({"runs": rows, "table": table}, indent=2))
    elif vehicle is None:
        _print_comparison(table)
    else:
        print_navigation(table)
    if interrupted():
        print(f"insonify: interrupted after {len(rows)} complete runs", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED)


def _compared(settings: list[str] | None, vehicle: str | None) -> list[Table]:
    """Single settings of a comparison, which chooses planners or navigation, and seeds, itself."""
    layers = single_layers(settings)
    for layer in layers:
        if "seed" in layer or ("planner" in layer and vehicle is None):
            key = "seed" if "seed" in layer else "planner"
            raise ConfigError(f"compare runs all planners and seeds; leave --set {key} out")
        if "navigation" in layer.get("vehicle", {}) and vehicle is not None:
            raise ConfigError("compare runs both navigations; leave --set vehicle.navigation out")
    return layers


def _mesh_table(mesh: Path | None) -> Table | None:
    """As a setting; absolute, so that the saved config runs from any folder."""
    if mesh is None:
        return None
    if not mesh.name:
        raise ConfigError(f"--object takes a mesh file, not {str(mesh)!r}")
    return {"mesh": str(mesh.absolute())}


def _write_results(run: Run, folder: Path) -> None:
    from insonify.io.configs import config_to_toml
    from insonify.io.maps import save_map, save_point_cloud
    from insonify.io.trajectories import save_track
    from insonify.report.html import write_report

    voxels = run.mapper.voxels
    if run.flight is not None:
        save_track(run.flight.track, folder / "trajectory.csv")
    text = json.dumps(run.result(), indent=2) + "\n"
    (folder / "result.json").write_text(text, encoding="utf-8")
    (folder / "config.toml").write_text(config_to_toml(run.config), encoding="utf-8")
    save_map(voxels, folder / "map.npz")
    region = run.world.area.region
    save_point_cloud(voxels, folder / "map.ply", run.config.entropy.high_entropy, region)
    write_report(run, folder / "report.html")


def _each(*consumers: Callable[[Run, Step], None]) -> Callable[[Run, Step], None]:
    """Several consumers of a run's steps as one."""

    def watch(run: Run, step: Step) -> None:
        for consumer in consumers:
            consumer(run, step)

    return watch


@contextmanager
def _progress() -> Iterator[Callable[[Run, Step], None]]:
    """A progress bar on stderr, fed by the steps of one run after another."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from insonify.mission import Decided, Mapped

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[speed]}"))
    console = stderr()
    shown = console.is_terminal
    with Progress(
        *columns, TimeElapsedColumn(), console=console, transient=True, disable=not shown
    ) as bar:
        task = bar.add_task("setting up", total=None, speed="")
        started = time.perf_counter()

        def watch(run: Run, step: Step) -> None:
            nonlocal started
            if isinstance(step, Decided):
                started = time.perf_counter()
                title = f"{run.config.scenario} {run.planner}, scan {len(run.paths) + 1}"
                bar.reset(task, total=run.config.survey.waypoints, description=title, speed="")
            elif isinstance(step, Mapped):
                done = len(run.paths[-1].waypoints)
                rate = done / max(time.perf_counter() - started, 1e-9)
                bar.update(task, completed=done, speed=f"{rate:.0f} pings/s")

        yield watch


def _print_result(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table as RichTable

    title = (
        f"{result['scenario']}, {result['planner']} planner, seed {result['seed']}: "
        f"{result['scans']} scans, {result['pings']} pings, {result['path_m']:.1f} m"
    )
    table = RichTable("truth", "match", "precision", "recall", "F1", "F2", "F3", title=title)
    for kind, matches in result["metrics"].items():
        for match, scores in matches.items():
            values = [f"{value:.3f}" for value in scores.values()]
            table.add_row(kind, match.replace("_", " "), *values)
    console = Console()
    console.print(table)
    if "vehicle" in result:
        flown, error = result["vehicle"], result["vehicle"]["pose_error"]
        perfect = flown["metrics_at_true_poses"]["solid"]["exact"]["f1"]
        console.print(
            f"{flown['name']} flew {flown['time_s']:.0f} s; its position was off by "
            f"{error['position_mean_m']:.2f} m in the mean, {error['position_max_m']:.2f} m at "
            f"most. Mapped at the true poses, solid F1 would be {perfect:.3f}.",
            highlight=False,
        )
    console.print(result["stop_reason"])


def _print_comparison(table: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table as RichTable

    from insonify.comparison import SCORES
    from insonify.scenarios import scenarios as known

    console = Console()
    for name, planners in table.items():
        source = known()[name]["paper"]["source"]
        order = [planner for planner in ("lawnmower", "uniform", "entropy") if planner in planners]
        view = RichTable(
            "", title=f"{name} (paper: {source})", box=box.SIMPLE, padding=(0, 1, 0, 0)
        )
        for planner in order:
            view.add_column(planner, no_wrap=True)
            view.add_column("paper", style="dim")
        tolerances = (("exact", "exact"), ("within_one_voxel", "±1 voxel"))
        for kind, (match, label) in product(("solid", "surface"), tolerances):
            view.add_row(f"[bold]{kind}, {label}")
            for score in SCORES:
                cells = []
                for planner in order:
                    figure = planners[planner][kind][match][score]
                    spread = "" if figure["ci95"] is None else f" ±{figure['ci95']:.3f}"
                    cells.append(f"{figure['mean']:.3f}{spread}")
                    cells.append(f"{planners[planner]['paper'][score]:.3f}")
                view.add_row(score, *cells)
            view.add_section()
        for key, label in (("scans", "scans"), ("pings", "pings"), ("path_m", "path, m")):
            figures = [f"{planners[planner][key]['mean']:.1f}" for planner in order]
            view.add_row(label, *(cell for figure in figures for cell in (figure, "")))
        console.print(view)
    console.print("Mean over the seeds ± half of its 95 % confidence interval.")
