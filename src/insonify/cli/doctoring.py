"""What this machine has, and what to do about what lacks."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from insonify.cli.printing import say_json, say_listing, tell
from insonify.cli.root import JsonOption, app


@app.command()
def doctor(as_json: JsonOption = False) -> None:
    """Say what this machine has of what is used, and what to do about each fault; sends nothing."""
    from insonify.doctor import examine

    findings = list(examine(Path.cwd()))
    if as_json:
        say_json([asdict(one) for one in findings])
        return
    say_listing(["what", "found"], [[one.what, one.told] for one in findings])
    faults = [one for one in findings if one.fault]
    for one in faults:
        tell(f"insonify: {one.what}: {one.fault}; {one.remedy}")
    if not faults:
        tell("insonify: nothing lacks")
