"""Planners, and navigations, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import console, say, say_json, say_table, tell
from insonify.cli.progress import begin, progress
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    MapperOption,
    OutOption,
    SetOption,
    absolute,
    app,
    choices,
    file_layers,
    interruptible,
    single_layers,
)
from insonify.cli.scans import steps_on
from insonify.cli.vehicles import (
    CurrentOption,
    VehicleOption,
    print_navigation,
    vehicle_table,
)
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from insonify.config.settings import Table
    from insonify.mission.result import ScanResult


_WIDE = 72
"""Characters from which on pings are told beside the path."""
PlannersOption = Annotated[
    list[str] | None,
    typer.Option(
        "--planner",
        metavar="NAME",
        help="Compare these, by name or your own: module:Name, file.py:Name; may be repeated. By "
        "default entropy, and uniform and lawnmower, both also begun near the object.",
    ),
]


@app.command()
def compare(
    names: Annotated[list[str], typer.Argument(metavar="SCENARIO...", help="Scenarios.")],
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each planner, seeds from 0.")] = 5,
    planners: PlannersOption = None,
    mapper: MapperOption = None,
    vehicle: VehicleOption = None,
    current: CurrentOption = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes; each has its share of the cores.")
    ] = 1,
    out: OutOption = None,
    force: ForceOption = False,
    every: Annotated[
        bool, typer.Option("--all", help="Print precision, recall, F1 to F3, and tolerances.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Compare planners over seeds, beside the paper's Tables 2 and 3.

    With a vehicle: compare maps made by its own navigation with those of perfect navigation.
    """
    begin("starting")
    if vehicle is None and current is not None:
        raise ConfigError("--current needs a vehicle to fly; add --vehicle bluerov2, for one")
    if vehicle is not None and planners:
        raise ConfigError(
            "with --vehicle, navigations are compared, not planners; name one planner by --set "
            "planner=NAME"
        )
    chosen = choices(vehicle=vehicle_table(vehicle, current), mapper=absolute(mapper))
    layers = [*file_layers(config), chosen, *_compared(settings, vehicle)]
    flown = vehicle is not None
    with result_folder_if(out, force) as scratch, interruptible() as interrupted:
        with progress("setting up") as bar:
            how = {"workers": workers, "watch": steps_on(bar), "should_stop": interrupted}
            rows = _runs(names, seeds, layers, planners, flown, how)
        if not rows:
            tell("insonify: interrupted before the first run was complete")
            raise typer.Exit(EXIT_INTERRUPTED)
        _tell(rows, scratch, flown=flown, as_json=as_json, every=every)
    if out is not None:
        tell(f"Rows: {out}")
    if interrupted():
        tell(f"insonify: interrupted after {len(rows)} complete runs")
        raise typer.Exit(EXIT_INTERRUPTED)


@contextmanager
def result_folder_if(out: Path | None, force: bool) -> Iterator[Path | None]:
    """Where results are written, if they are wanted."""
    from insonify.io.folders import result_folder

    if out is None:
        yield None
    else:
        with result_folder(out, force=force) as place:
            yield place.scratch


def _tell(
    rows: list[ScanResult], folder: Path | None, *, flown: bool, as_json: bool, every: bool
) -> None:
    """Write and print the table."""
    from insonify.mission.comparison import summarise, summarise_navigation
    from insonify.results.comparison import save_comparison

    table = summarise_navigation(rows) if flown else summarise(rows)
    if folder is not None:
        save_comparison(rows, table, folder)
    if as_json:
        say_json({"runs": [row.to_json() for row in rows], "table": table})
    elif flown:
        print_navigation(table)
    else:
        print_comparison(table, every=every)


def _runs(
    names: list[str],
    seeds: int,
    layers: list[Table],
    planners: list[str] | None,
    flown: bool,
    how: dict[str, Any],
) -> list[ScanResult]:
    from insonify.mission.comparison import compare as compare_planners
    from insonify.mission.comparison import compare_navigation
    from insonify.planning.factory import COMPARED

    if flown:
        return compare_navigation(names, seeds, layers, **how)
    order = [absolute(planner) or planner for planner in planners or COMPARED]
    return compare_planners(names, seeds, layers, order, **how)


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


def print_comparison(table: Table, *, every: bool) -> None:
    """A comparison of planners for people, a row each beside the paper's: F1, or every score."""
    from insonify.mission.comparison import SCORES
    from insonify.mission.setup import scenarios as known

    tolerances = {"exact": "voxel for voxel", "within_one_voxel": "within one voxel"}
    for name, planners in table.items():
        paper = known()[name].get("paper")
        title = name if paper is None else f"{name} (paper: {paper['source']})"
        if not every:
            columns = {f"F1, {kind}": (kind, "exact", "f1") for kind in ("solid", "surface")}
            say_table(_view(f"{title}, voxel for voxel", planners, columns))
            continue
        for kind, match in product(("solid", "surface"), tolerances):
            columns = {score: (kind, match, score) for score in SCORES}
            what = f"{title}, {kind}, {tolerances[match]}"
            say_table(_view(what, planners, columns, spread=False))
    spread = "" if every else " ± half of its 95 % confidence interval"
    say(f"Mean over the seeds{spread}.")


def _view(
    title: str, planners: Table, columns: dict[str, tuple[str, str, str]], *, spread: bool = True
) -> RichTable:
    """Some scores of planners, and what they took; the paper's scores a line below."""
    from rich import box
    from rich.table import Table as RichTable

    view = RichTable("planner", title=title, box=box.SIMPLE, padding=(0, 1, 0, 0))
    spent = {"pings": "pings", "path, m": "path_m"}
    if console().width < _WIDE:
        del spent["pings"]
    for head in (*columns, *spent):
        view.add_column(head, justify="right")
    short = [planner.rpartition(":")[2] for planner in planners]
    for (planner, figures), head in zip(planners.items(), short, strict=True):
        cells = [
            _figure(figures[kind][match][score], spread) for kind, match, score in columns.values()
        ]
        cells += [f"{figures[key]['mean']:.1f}" for key in spent.values()]
        view.add_row(head if short.count(head) == 1 else planner, *cells)
        if "paper" in figures:
            theirs = (f"{figures['paper'][score]:.3f}" for _, _, score in columns.values())
            view.add_row("  paper", *theirs, style="dim")
    return view


def _figure(figure: dict[str, float | None], spread: bool) -> str:
    half = f" ±{figure['ci95']:.3f}" if spread and figure["ci95"] is not None else ""
    return f"{figure['mean']:.3f}{half}"
