"""What this machine has, and what to do about what lacks."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from insonify.cli.printing import say_json, say_listing, tell
from insonify.cli.root import EXIT_FAILED, JsonOption, app


@app.command()
def doctor(
    live: Annotated[
        Path | None,
        typer.Option(
            "--live",
            metavar="DIR",
            help="Only whether a session that writes to DIR, or in it, runs and maps.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what this machine has of what is used, and what to do about each fault; sends nothing."""
    from insonify.doctor import examine, examine_session

    findings = list(examine(Path.cwd())) if live is None else [examine_session(live)]
    faults = [one for one in findings if one.fault]
    if as_json:
        say_json([asdict(one) for one in findings])
    else:
        say_listing(["what", "found"], [[one.what, one.told] for one in findings])
        for one in faults:
            tell(f"insonify: {one.what}: {one.fault}; {one.remedy}")
        if not faults:
            tell("insonify: nothing lacks")
    if faults and live is not None:
        raise typer.Exit(EXIT_FAILED)
