"""Campaigns, and questions to their results."""

from __future__ import annotations

import json
import signal
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import say, say_json, say_listing, say_table, tell
from insonify.cli.progress import Bar, begin, progress
from insonify.cli.root import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    Interrupted,
    JsonOption,
    OutOption,
    SetOption,
    app,
    interruptible,
    print_report,
    single_layers,
)
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.config.settings import Table
    from insonify.mission.result import CampaignResult


@app.command()
def campaign(
    file: Annotated[
        Path, typer.Argument(metavar="FILE|DIR", help="TOML, or the folder of one that goes on.")
    ],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; by default one for each core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Fly on the Dask cluster of this scheduler."),
    ] = None,
    settings: SetOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly mappers x planners x scenarios x sonars x navigation x seeds; killed, it goes on."""
    begin("starting")
    from insonify.mission.campaign import read_campaign
    from insonify.mission.crew import all_cores
    from insonify.results.campaign import CAMPAIGN, run_campaign

    if workers is not None and scheduler is not None:
        raise ConfigError("--workers are processes here, and --scheduler has its own; give one")
    folder = out or (file if file.is_dir() else Path("insonify-runs") / file.stem)
    what = read_campaign(file / CAMPAIGN if file.is_dir() else file, single_layers(settings))
    ending = "stopping; what is complete is kept, and the same command goes on from there"
    with (
        interruptible(ending, signal.SIGINT, signal.SIGTERM) as interrupted,
        progress("runs") as bar,
    ):
        try:
            result = run_campaign(
                what,
                folder,
                workers=workers or all_cores(),
                scheduler=scheduler,
                watch=partial(_show, bar),
                should_stop=interrupted,
            )
        except Interrupted:
            raise typer.Exit(EXIT_INTERRUPTED) from None  # told at the first Ctrl-C
    if as_json:
        say_json(result.to_json())
    else:
        _print_summary(list(result.table))
    print_report(folder)
    _end(result, folder, interrupted())


def _show(bar: Bar, done: int, failed: int, planned: int) -> None:
    bar.show(done, planned, note=f"{done} of {planned}" + f", {failed} failed" * (failed > 0))


def _end(result: CampaignResult, folder: Path, interrupted: bool) -> None:
    """Say what is not there, and tell by the exit code."""
    if interrupted:
        tell(f"insonify: interrupted after {result.runs} of {result.planned} runs")
        raise typer.Exit(EXIT_INTERRUPTED)
    if result.failed:
        tell(
            f"insonify: {result.failed} of {result.planned} runs failed: {_first(folder)}; all are "
            f"told in {folder / 'failed'}, and the same command tries them again"
        )
        raise typer.Exit(EXIT_FAILED)


def _first(folder: Path) -> str:
    """What the first of the failed runs says."""
    told = [
        json.loads(file.read_text(encoding="utf-8"))
        for file in sorted((folder / "failed").glob("*.json"))
    ]
    causes = [row["message"] for row in told]
    return str(causes[0]) if causes else "unknown"


@app.command()
def results(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a campaign.")],
    sql: Annotated[
        str | None,
        typer.Option(metavar="QUERY", help="Ask the tables runs, curves, seconds, in SQL."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show a campaign's results, or ask them in SQL; also while it is flown."""
    from insonify.mission.tables import summarise_campaign
    from insonify.results.campaign import load_campaign, query

    if sql is not None:
        names, rows = query(folder, sql)
        if as_json:
            told = [dict(zip(names, row, strict=True)) for row in rows]
            say_json(told)
        else:
            say_listing(names, [[_text(value) for value in row] for row in rows])
        return
    tables = load_campaign(folder)
    summary = summarise_campaign(tables) if len(tables.runs) else []
    if as_json:
        say_json(summary)
    else:
        _print_summary(summary)


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _print_summary(rows: list[Table]) -> None:
    """Means over the seeds, a table for each setting."""
    from itertools import groupby

    from rich import box
    from rich.table import Table as RichTable

    from insonify.mission.tables import HEADLINE, SETTING, short

    if not rows:
        say("no run is complete")
        return
    headings = (HEADLINE.replace("_", " "), "along path", "over pings", "path, m")
    for setting, inside in groupby(rows, key=lambda row: tuple(row[name] for name in SETTING)):
        view = RichTable(
            "mapper", "planner", *headings,
            title=", ".join(setting), box=box.SIMPLE, padding=(0, 1, 0, 0),
        )  # fmt: skip
        for row in inside:
            figures = [_spread(row[key], 3) for key in (HEADLINE, "area_path", "area_pings")]
            names = (short(row["mapper"]), short(row["planner"]))
            view.add_row(*names, *figures, _spread(row["path_m"], 1))
        say_table(view)
    say("Mean over the seeds ± half of its 95 % confidence interval.")


def _spread(figure: dict[str, float | None], digits: int) -> str:
    half = "" if figure["ci95"] is None else f" ±{figure['ci95']:.{digits}f}"
    return f"{figure['mean']:.{digits}f}{half}"
