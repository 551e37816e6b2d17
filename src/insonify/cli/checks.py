"""Whether recordings are what they are taken for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say, say_json, say_listing
from insonify.cli.progress import begin, progress
from insonify.cli.reading import takes_reading
from insonify.cli.root import JsonOption, app

if TYPE_CHECKING:
    from insonify.mission.check import Check


@app.command()
@takes_reading
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: file or folder.")],
    reading: Any = None,
    as_json: JsonOption = False,
) -> None:
    """Tell whether a recording is mirrored, tilted the wrong way or off in time."""
    begin("starting")
    from insonify.io.recordings import open_recording
    from insonify.mission.check import check_recording

    with progress("comparing pings") as bar:
        bar.show(0, 1, file.name, "")
        found = check_recording(open_recording(file, reading), reading)
    if as_json:
        say_json(found.to_json())
    else:
        say_listing(["question", "answer", "why"], _rows(found))
        say(f"{file}: {found.conclusion}.")
        if found.options:
            say(f"To set it right: insonify map {file} {' '.join(found.options)} ...")


def _rows(found: Check) -> list[list[str]]:
    questions = [("port and starboard", found.side), ("tilt", found.tilt)]
    if found.clock is not None:
        questions.append(("clock", found.clock))
    return [[question, finding.answer.value, finding.why] for question, finding in questions]
