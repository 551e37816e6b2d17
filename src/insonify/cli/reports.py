"""The report of a scan or campaign, made again from its files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from insonify.cli.printing import say_json, tell
from insonify.cli.root import JsonOption, app


@app.command()
def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Result folder of scan or campaign.")],
    out: Annotated[
        Path | None, typer.Option(metavar="HTML", help="By default report.html in RUN.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make the report of a scan or campaign again from its files; nothing is run again."""
    from insonify.io.folders import result_file
    from insonify.results.campaign import is_campaign
    from insonify.results.scan import REPORT

    target = out or run / REPORT
    write = _campaign_writer(run) if is_campaign(run) else _scan_writer(run)
    with result_file(target, force=True) as scratch:
        write(scratch)
    if as_json:
        say_json({"report": str(target)}, indent=None)
    else:
        tell(f"Report: {target}")


def _scan_writer(run: Path) -> Callable[[Path], None]:
    from insonify.report.html import write_report
    from insonify.results.scan import load_run

    return partial(write_report, load_run(run, with_keyframes=True))


def _campaign_writer(run: Path) -> Callable[[Path], None]:
    from insonify.report.campaign_html import write_campaign_report
    from insonify.results.campaign import load_campaign

    return partial(write_campaign_report, load_campaign(run))
