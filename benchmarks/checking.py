"""How often `insonify check` is right: simulated recordings, taken wrongly in every way.

``python -m benchmarks.checking RUN...`` takes folders of `scan` or `simulate`, makes each mirrored,
tilted the other way, upside down and none of these, and prints what the check finds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from insonify.frames import pose_from_transform, transform_from_pose
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Recording
from insonify.mission.check import Check, check_recording
from insonify.mission.findings import Answer
from insonify.types import PosedPing

FAULTS = {
    "none": (False, False),
    "mirrored": (True, False),
    "tilt": (False, True),
    "upside down": (True, True),
}


def spoilt(recording: Recording, mirrored: bool, tilted: bool) -> Recording:
    """A recording with its columns the other way round, or its mount's tilt of the other sign.

    Both at once are a sonar upside down that is not told to be.
    """
    flip = np.diag([1.0, 1.0, -1.0, 1.0])

    def read() -> Iterator[PosedPing]:
        for posed in recording.read():
            ping = posed.ping
            if mirrored:
                ping = replace(ping, image=np.ascontiguousarray(ping.image[:, ::-1]))
            if tilted:
                mount = flip @ transform_from_pose(ping.geometry.mount) @ flip
                fan = replace(ping.geometry, mount=pose_from_transform(mount))
                ping = replace(ping, geometry=fan)
            yield replace(posed, ping=ping)

    return replace(recording, read=read)


def right(found: Check, mirrored: bool, tilted: bool) -> bool | None:
    """Whether a check has found out; None if it says that it cannot tell."""
    if Answer.UNKNOWN in {found.side.answer, found.tilt.answer}:
        known = [
            finding.answer.otherwise == wrong
            for finding, wrong in ((found.side, mirrored), (found.tilt, tilted))
            if finding.answer is not Answer.UNKNOWN
        ]
        return None if all(known) else False
    return (found.side.answer.otherwise, found.tilt.answer.otherwise) == (mirrored, tilted)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    counts = {True: 0, False: 0, None: 0}
    for run in parser.parse_args().runs:
        recording = open_recording(run / "recording.mcap" if run.is_dir() else run)
        for name, (mirrored, tilted) in FAULTS.items():
            found = check_recording(spoilt(recording, mirrored, tilted))
            verdict = right(found, mirrored, tilted)
            counts[verdict] += 1
            word = {True: "right", False: "WRONG", None: "cannot tell"}[verdict]
            clock = found.clock.answer.value if found.clock is not None else "no clock"
            print(f"{run.name:28} {name:12} {word:12} {found.conclusion}; {clock}", flush=True)
    print(f"right {counts[True]}, wrong {counts[False]}, cannot tell {counts[None]}")
    sys.exit(1 if counts[False] else 0)


if __name__ == "__main__":
    main()
