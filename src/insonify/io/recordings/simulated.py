"""The result folder of ``simulate`` as a recording: its pings with the poses they were taken at."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

from insonify.errors import RecordingError
from insonify.io.pings import is_sweep, load_ping
from insonify.io.recordings.recording import (
    BEAMS,
    Reading,
    Recording,
    RecordingWarning,
    columns,
    corrected,
)
from insonify.types import PosedPing

PINGS = "pings"


def read_simulated(path: Path, reading: Reading) -> Recording | None:
    """Open a result folder of ``simulate``; None of another folder.

    Raises:
        RecordingError: Its first ping cannot be read; turns of a scanning sonar are no fans.
    """
    files = sorted((path / PINGS).glob("*.npz"))
    if not files or not (path / "config.toml").is_file():
        return None
    try:
        load_ping(files[0])
    except RecordingError:
        if not is_sweep(files[0]):
            raise
        raise RecordingError(
            f"{path}: turns of a scanning sonar, whose pings are no fans to map or view"
        ) from None

    def read() -> Iterator[PosedPing]:
        for file in files:
            try:
                posed, _ = load_ping(file)
            except RecordingError as err:
                warnings.warn(f"{err}; it is left out", RecordingWarning, stacklevel=2)
                continue
            yield corrected(posed, reading)

    facts = {
        "poses": f"{len(files)}, where they were simulated",
        "columns": columns(reading.beams != BEAMS[1]),
    }
    return Recording(path, "result of simulate", len(files), True, facts, read, exact=True)
