"""The result folder of ``simulate`` as a recording: its pings with the poses they were taken at."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.io.archives import DAMAGE, Archive
from insonify.io.pings import fan_figures, is_sweep, load_ping, load_sweep
from insonify.io.recordings.recording import (
    Reading,
    Recording,
    RecordingWarning,
    corrected,
    refuse_beams,
    refuse_scale,
)
from insonify.types import FanGeometry, Ping, Pose, PosedPing, estimated

PINGS, STACK = "pings", "pings.npz"
_FORMAT = "result of simulate"


def read_simulated(path: Path, reading: Reading) -> Recording | None:
    """Open a result folder of ``simulate``; None of another folder.

    Raises:
        RecordingError: Its first ping, or turn of a scanning sonar, cannot be read.
    """
    if not (path / "config.toml").is_file():
        return None
    if (path / STACK).is_file():
        return replace(read_tour(path / STACK, reading), path=path, format=_FORMAT)
    files = sorted((path / PINGS).glob("*.npz"))
    if not files:
        return None
    turns = is_sweep(files[0])
    refuse_scale(path, reading)
    if turns:
        refuse_beams(path, reading)
    count = len(files)
    if turns:
        count *= len(load_sweep(files[0]))
    else:
        load_ping(files[0])

    def read() -> Iterator[PosedPing]:
        for file in files:
            try:
                pings = load_sweep(file) if turns else [load_ping(file)[0]]
            except RecordingError as err:
                warnings.warn(f"{err}; it is left out", RecordingWarning, stacklevel=2)
                continue
            for posed in pings:
                yield corrected(posed, reading)

    facts = {
        "poses": f"{count}, where they were simulated",
        "columns": reading.columns(port_first=True),
    }
    return Recording(path, _FORMAT, count, True, facts, read, exact=True)


TOUR = {"images", "head_rad", "estimated_pose", "true_pose"}
"""Arrays that only a `PingStack` holds, as ``fly`` leaves."""


def read_tour(path: Path, reading: Reading) -> Recording:
    """Open what ``fly`` heard with one sonar, ``SONAR.npz``.

    Raises:
        RecordingError: Its arrays do not fit together.
    """
    try:
        arrays = Archive(path, RecordingError)
        azimuth, elevation, near, far = fan_figures(arrays)
        images, times = arrays["images"], arrays["time_s"]
        count, bins, beams = images.shape
        tables = {name: arrays[name] for name in ("estimated_pose", "true_pose", "mount")}
        if any(table.shape != (count, 6) for table in tables.values()) or len(times) != count:
            raise ValueError("its tables are not of one length")
        std = arrays.get("estimated_std", np.zeros((count, 2)))  # not told by version 0.1
        if std.shape != (count, 2):
            raise ValueError("its tables are not of one length")
    except (*DAMAGE, KeyError) as err:
        raise RecordingError(f"{path}: damaged ({reason(err)})") from err
    refuse_scale(path, reading)
    if beams == 1:
        refuse_beams(path, reading)

    def read() -> Iterator[PosedPing]:
        for number in range(count):
            pose, true, mount = (Pose(*map(float, table[number])) for table in tables.values())
            fan = FanGeometry(azimuth, elevation, beams, bins, near, far, mount)
            image = np.ascontiguousarray(images[number], np.float32)
            head_rad = float(arrays["head_rad"][number])
            ping = Ping(image, fan, float(times[number]), head_rad)
            posed = PosedPing(ping, estimated(pose, std[number]), true)
            yield corrected(posed, reading)

    facts = {
        "poses": f"{count}, as the vehicle believed",
        "columns": reading.columns(port_first=True),
    }
    return Recording(path, "result of fly", count, True, facts, read, exact=True)
