"""Routes as files: a CSV table of poses, or a TUM trajectory."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from insonify.errors import RecordingError, reading
from insonify.io.recordings.poses import read_poses

_NEEDED = ("x_m", "y_m", "z_m")
_COLUMNS = ("time_s", *_NEEDED, "roll_deg", "pitch_deg", "yaw_deg")
Row = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Route:
    """Rows of time (s), x, y, z (m), roll, pitch, yaw (degrees); the file may give no times."""

    rows: tuple[Row, ...]
    timed: bool


def read_route(path: Path) -> Route:
    """The poses of a file.

    A CSV file has a first line of names: ``x_m, y_m, z_m`` and, as wanted, ``time_s``,
    ``roll_deg``, ``pitch_deg``, ``yaw_deg``.  A file without names is a TUM trajectory, lines of
    ``time x y z qx qy qz qw``; its times are counted from the first.

    Raises:
        RecordingError: The file is missing or empty, or a line is no pose; the line is named.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as err:
        raise RecordingError(f"{path}: there is no such file of poses; check the path") from err
    except (OSError, UnicodeDecodeError) as err:
        raise RecordingError(f"{path}: cannot be read as text ({err})") from err
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise RecordingError(f"{path}: there are no poses in it")
    named = any(name in lines[0][1] for name in _NEEDED)
    with reading(path, "a table of poses", RecordingError, csv.Error):
        route = _table(path, lines) if named else _tum(path)
    if route.timed:
        for before, after in pairwise(row[0] for row in route.rows):
            if not after > before:
                raise RecordingError(
                    f"{path}: time {after:g} s does not follow {before:g} s; sort the lines by "
                    "time, without repeats"
                )
    return route


def _table(path: Path, lines: list[tuple[int, str]]) -> Route:
    names = [name.strip() for name in next(csv.reader([lines[0][1]]))]
    unknown = sorted(set(names) - set(_COLUMNS))
    missing = sorted(set(_NEEDED) - set(names))
    if unknown or missing:
        what = f"unknown column {unknown[0]!r}" if unknown else f"no column {missing[0]!r}"
        raise RecordingError(f"{path}: {what}; columns are {', '.join(_COLUMNS)}")
    if len(lines) == 1:
        raise RecordingError(f"{path}: there are no poses in it")
    timed = "time_s" in names
    rows = []
    for count, (number, line) in enumerate(lines[1:]):
        values = dict(
            zip(names, _numbers(path, number, next(csv.reader([line])), len(names)), strict=True)
        )
        time_s = values.get("time_s", float(count))
        rows.append((time_s, *(values.get(name, 0.0) for name in _COLUMNS[1:])))
    return Route(tuple(rows), timed)


def _tum(path: Path) -> Route:
    track = read_poses(path)
    rows = []
    for number, time_s in enumerate(track.times_s - track.times_s[0]):
        pose = track.sample(number)
        angles = map(math.degrees, (pose.roll_rad, pose.pitch_rad, pose.yaw_rad))
        rows.append((float(time_s), *pose.position_m, *angles))
    return Route(tuple(rows), True)


def _numbers(path: Path, number: int, words: list[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as err:
        raise RecordingError(f"{path}, line {number}: {err}; a line is {count} numbers") from err
    if len(values) != count or not all(map(math.isfinite, values)):
        raise RecordingError(
            f"{path}, line {number}: needs {count} finite numbers, not {' '.join(words)!r}"
        )
    return values
