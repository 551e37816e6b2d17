"""A scan's report, made again from its files."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from insonify.cli.root import JsonOption, app


@app.command()
def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Result folder of scan.")],
    out: Annotated[
        Path | None, typer.Option(metavar="HTML", help="By default report.html in RUN.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a scan's report again from its files; nothing is run again."""
    from insonify.io.folders import result_file
    from insonify.report.html import write_report
    from insonify.results.scan import REPORT, load_scan

    account = load_scan(run, with_keyframes=True)
    target = out or run / REPORT
    with result_file(target, force=True) as scratch:
        write_report(account, scratch)
    if as_json:
        print(json.dumps({"report": str(target)}))
    else:
        print(f"Report: {target}", file=sys.stderr)
