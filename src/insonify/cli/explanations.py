"""Why a voxel of a map is what it is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say, say_json, tell
from insonify.cli.progress import begin, progress
from insonify.cli.reading import takes_reading
from insonify.cli.root import JsonOption, app

if TYPE_CHECKING:
    from insonify.mission.explanation import Explanation, Glimpse

_HEAD = ("ping", "time s", "range m", "azimuth °", "beams", "bins", "of 255", "p", "shows")
"""Ping number, what the voxel covers in it, the brightest of that, the voxel's p after it."""
_TILES = 12
"""Of a picture, at most."""


@app.command()
@takes_reading
def explain(
    map_: Annotated[
        Path, typer.Argument(metavar="MAP", help="Result folder of scan or map, or its map file.")
    ],
    voxel: Annotated[
        tuple[float, float, float],
        typer.Option("--voxel", metavar="X Y Z", help="A place in it, metres in the world."),
    ],
    picture: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Write the images around it, of the pings that mattered."),
    ] = None,
    recording: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Where the pings are now; of several recordings, once for each."
        ),
    ] = None,
    reading: Any = None,
    as_json: JsonOption = False,
) -> None:
    """Say which pings made a voxel what it is, by mapping them again."""
    begin("starting")
    from insonify.io.maps import load_map
    from insonify.mission.explanation import explain_voxel, voxel_at
    from insonify.results.map import config_of, empty_mapper
    from insonify.results.sources import folder_of, pings_of, result_of

    folder, result = folder_of(map_), result_of(map_)
    saved = load_map(map_)
    index = voxel_at(saved, voxel)
    mapper, how = empty_mapper(folder, saved.voxel_m), config_of(folder).mapping
    with progress("opening") as bar:
        played = pings_of(folder, result, reading, recording or ())
        told = explain_voxel(
            played, mapper, how, saved, index,
            lambda done, count: bar.show(done, count, "mapping again", f"{done} of {count}"),
        )  # fmt: skip
    if picture is not None:
        _draw(told, picture)
    if as_json:
        say_json(_document(told))
    else:
        _print(told)
    if told.differing:
        tell(f"insonify: warning: {_difference(told)}")


def _draw(told: Explanation, picture: Path) -> None:
    from insonify.io.folders import write_file
    from insonify.report.cutouts import draw_glimpses

    glimpses = told.telling(_TILES)
    if not glimpses:
        tell("insonify: no ping has it in view, so there is no picture")
        return
    write_file(picture, draw_glimpses(glimpses, _heading(told)))
    tell(f"Picture: {picture}")


def _probability(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-log_odds))


def _heading(told: Explanation) -> str:
    place = ", ".join(f"{c + 0.0:.6g}" for c in told.centre_m)
    of_it = {True: ", surface", False: ", no surface", None: ""}[told.surface]
    return f"Voxel at ({place}) m: {told.state}{of_it}, p = {_probability(told.log_odds):.3f}"


def _difference(told: Explanation) -> str:
    saved, again = (f"{_probability(odds):.6g}" for odds in (told.log_odds, told.replayed))
    here = "it has the same probability" if saved == again else f"it has {again} and not {saved}"
    return (
        f"mapped again, {here}, and {told.differing} voxels of the map differ: the pings, what was "
        "said of them when they were mapped (--sonar, --poses, --mount...), the mapper or insonify "
        "have changed, or the map's format keeps less; so this may not be how it was made"
    )


def _document(told: Explanation) -> dict[str, Any]:
    """As JSON."""
    return {
        "voxel": list(told.voxel),
        "centre_m": [round(c, 9) for c in told.centre_m],
        "state": told.state,
        "surface": told.surface,
        "probability": _probability(told.log_odds),
        "probability_replayed": _probability(told.replayed),
        "voxels_differing": told.differing,
        "pings": told.pings,
        "reached_by": [_row(one) for one in told.glimpses],
    }


def _row(one: Glimpse) -> dict[str, Any]:
    row: dict[str, Any] = {
        "recording": str(one.recording), "ping": one.number, "time_s": one.time_s,
        "shows": one.says, "lit": one.shown.lit, "dark": one.shown.dark, "parts": one.shown.parts,
        "probability_before": _probability(one.before),
        "probability": _probability(one.shown.log_odds),
    }  # fmt: skip
    if one.pixels is not None:
        row |= {
            "beams": list(one.pixels.beams), "bins": list(one.pixels.bins),
            "range_m": one.pixels.range_m, "azimuth_deg": math.degrees(one.pixels.azimuth_rad),
            "elevation_deg": math.degrees(one.pixels.elevation_rad),
            "brightest": one.brightest, "echo_before_m": one.echo_m,
        }  # fmt: skip
    return row


def _print(told: Explanation) -> None:
    say(_heading(told))
    if not told.glimpses:
        say(f"None of {told.pings} pings reaches it: it was never looked at.")
        return
    several = len({one.recording for one in told.glimpses}) > 1
    rows = [_HEAD, *(_cells(one) for one in told.glimpses)]
    if several:
        names = ["recording", *(one.recording.name for one in told.glimpses)]
        rows = [(name, *row) for name, row in zip(names, rows, strict=True)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for *cells, last in rows:
        padded = (cell.rjust(width) for cell, width in zip(cells, widths, strict=False))
        say("  ".join([*padded, last]).rstrip())
    say(f"{len(told.glimpses)} of {told.pings} pings reach it or change it.")


def _cells(one: Glimpse) -> tuple[str, ...]:
    where = ["", "", "", "", ""]
    if one.pixels is not None:
        where = [
            f"{one.pixels.range_m:.2f}",
            f"{math.degrees(one.pixels.azimuth_rad):+.1f}",
            "-".join(map(str, sorted(set(one.pixels.beams)))),
            "-".join(map(str, sorted(set(one.pixels.bins)))),
            "?" if one.brightest is None else f"{255.0 * one.brightest:.0f}",
        ]
    after = f"{_probability(one.shown.log_odds):.3f}"
    return (str(one.number), f"{one.time_s:.2f}", *where, after, one.says)
