"""The pings that a result's map was made of, as they lie beside it or where it says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from insonify.errors import ResultError
from insonify.io.decisions import load_decisions
from insonify.io.folders import RESULT
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading
from insonify.mission.explanation import Played
from insonify.mission.result import MapResult, ScanResult, TourResult
from insonify.results.files import CONFIG, RECORDING, load_result
from insonify.results.scan import DECISIONS


def folder_of(path: Path) -> Path:
    """The result's folder of a map: itself, or the one that the file lies in."""
    return path if path.is_dir() and path.suffix != ".zarr" else path.parent


def result_of(path: Path) -> ScanResult | MapResult:
    """The figures beside a map, which say how it was made.

    Args:
        path: A result's folder of ``scan`` or ``map``, or a map file in it.

    Raises:
        ResultError: There are none, or of another command.
    """
    folder = folder_of(path)
    if not path.exists():
        raise ResultError(f"{path}: there is no such result or map; check the path")
    if not (folder / RESULT).is_file() or not (folder / CONFIG).is_file():
        raise ResultError(
            f"{path}: nothing beside it says of which pings it was made, and how; give the result "
            "folder of `insonify scan` or `insonify map` that it is from"
        )
    result = load_result(folder)
    if isinstance(result, TourResult):
        raise ResultError(
            f"{folder}: `fly` leaves pings and no map; map them first (insonify map "
            f"{folder}/SONAR.npz --out M), then explain M"
        )
    if not isinstance(result, ScanResult | MapResult):
        raise ResultError(f"{folder}: the result of another command ({result.kind}), not a map")
    return result


def pings_of(
    folder: Path,
    result: ScanResult | MapResult,
    reading: Reading,
    moved: Sequence[Path] = (),
) -> list[Played]:
    """The recordings that a map was made of, and how many of their pings, scan by scan.

    Args:
        folder: Of the result.
        result: Its figures.
        reading: What the user said of the recordings when they were mapped.
        moved: Where the recordings lie now, if not where the result says.

    Raises:
        ResultError: The pings are not at hand.
        InsonifyError: A recording cannot be read.
    """
    if isinstance(result, ScanResult):
        return [_scanned(folder, moved, reading)]
    return _mapped(folder, result, moved, reading)


def _scanned(folder: Path, moved: Sequence[Path], reading: Reading) -> Played:
    if len(moved) > 1:
        raise ResultError(f"{folder}: a scan has one recording, not {len(moved)}")
    path = moved[0] if moved else folder / RECORDING
    if not path.exists():
        raise ResultError(
            f"{path}: there is no such recording, so the scan's pings are not at hand; say where "
            f"it is (--recording), or scan again (insonify scan --config {folder / CONFIG})"
        )
    _, paths = load_decisions(folder / DECISIONS)
    return Played(open_recording(path, reading), tuple(len(path.waypoints) for path in paths))


def _mapped(
    folder: Path, result: MapResult, moved: Sequence[Path], reading: Reading
) -> list[Played]:
    files = [Path(source["file"]) for source in result.recordings]
    if moved and len(moved) != len(files):
        raise ResultError(
            f"{folder}: was mapped of {len(files)} recordings, and {len(moved)} are given; give "
            f"them all, in this order: {', '.join(map(str, files))}"
        )
    for file in moved or files:
        if not file.exists():
            raise ResultError(
                f"{file}: there is no such recording, so the pings of {folder} are not at hand; go "
                "where it was mapped from, or say where they are (--recording, once for each)"
            )
    return [
        Played(open_recording(file, reading), (int(source["pings"]),))
        for file, source in zip(moved or files, result.recordings, strict=True)
    ]
