"""What earlier commands have left in a folder, and clearing it."""

from __future__ import annotations

import shutil
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say, say_json, say_listing, tell
from insonify.cli.root import JsonOption, app
from insonify.errors import OutputError

if TYPE_CHECKING:
    from insonify.mission.result import Result

_AGES = ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes"), (0.0, "seconds"))


@app.command()
def runs(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where results lie.")] = Path(
        "insonify-runs"
    ),
    prune: Annotated[
        bool,
        typer.Option(
            "--prune", help="Remove scans of which there is a newer one of the very same config."
        ),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Remove without asking.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the results in a folder with size, age and figures; --prune clears repeated ones."""
    if not folder.is_dir():
        raise OutputError(f"{folder}: there is no such folder; name one that has results in it")
    found = _found(folder)
    if as_json and not prune:
        say_json(found)
    elif not prune:
        say_listing(["name", "size", "age", "figures"], [_cells(row) for row in found])
        tell(f"{len(found)} results, {size_text(sum(row['bytes'] for row in found))}, in {folder}")
    else:
        _prune(folder, found, yes=yes, as_json=as_json)


def _prune(folder: Path, found: list[dict[str, Any]], *, yes: bool, as_json: bool) -> None:
    """Remove scans of which there is a newer one of the same config, after asking."""
    old = _repeated(folder, found)
    freed = size_text(sum(row["bytes"] for row in old))
    if old and not yes:
        for row in old:
            tell(f"  {row['name']}: {size_text(row['bytes'])}, {_age(row['age_s'])} old")
        typer.confirm(
            f"Remove these {len(old)} results ({freed}) from {folder}?", abort=True, err=True
        )
    for row in old:
        shutil.rmtree(folder / row["name"])
    if as_json:
        say_json({"removed": [row["name"] for row in old]})
    else:
        say(f"{len(old)} results removed, {freed}" if old else "Nothing is there twice.")


def _found(folder: Path) -> list[dict[str, Any]]:
    """The results in a folder, the newest first."""
    from insonify.errors import ResultError
    from insonify.io.folders import RESULT
    from insonify.results.files import load_result

    rows = []
    for place in folder.iterdir():
        if place.name.startswith(".") or not (place / RESULT).is_file():
            continue
        try:
            result = load_result(place)
            kind, figures = result.kind, _figures(result)
        except ResultError:
            kind, figures = "unknown", "cannot be read"
        rows.append(
            {
                "name": place.name,
                "kind": kind,
                "bytes": folder_bytes(place),
                "age_s": round(time.time() - (place / RESULT).stat().st_mtime, 1),
                "figures": figures,
            }
        )
    return sorted(rows, key=lambda row: (row["age_s"], row["name"]))


def _figures(result: Result) -> str:
    """A result's main figures in words."""
    from insonify.mission.result import ComparisonResult, DatasetResult, MapResult, ScanResult
    from insonify.types import StopReason

    if isinstance(result, ScanResult):
        f1 = result.metrics["solid"]["exact"]["f1"]
        cut = ", interrupted" if result.stop_reason is StopReason.INTERRUPTED else ""
        return f"F1 {f1:.3f}, {result.pings} pings, {result.path_m:.0f} m{cut}"
    if isinstance(result, MapResult):
        return f"{result.occupied_voxels} occupied voxels, {result.pings} pings"
    if isinstance(result, ComparisonResult):
        return f"{len(result.runs)} runs compared"
    if isinstance(result, DatasetResult):
        return f"{result.views} views"
    return result.kind


def _repeated(folder: Path, found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those of a scan that have a newer one of the very same config beside them."""
    from insonify.results.files import CONFIG

    alike: defaultdict[bytes, list[dict[str, Any]]] = defaultdict(list)
    for row in found:
        config = folder / row["name"] / CONFIG
        if row["kind"] == "scan" and config.is_file():
            alike[config.read_bytes()].append(row)
    return [row for rows in alike.values() for row in rows[1:]]


def _cells(row: dict[str, Any]) -> list[str]:
    return [row["name"], size_text(row["bytes"]), _age(row["age_s"]), row["figures"]]


def folder_bytes(folder: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def size_text(count: float) -> str:
    """A number of bytes as people say it."""
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} GB"


def _age(seconds: float) -> str:
    least, word = next(pair for pair in _AGES if seconds >= pair[0])
    return f"{seconds / (least or 1.0):.0f} {word}"
