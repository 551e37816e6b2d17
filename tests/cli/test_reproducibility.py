"""The same seed, the same bytes: whatever the threads, and however Python shuffles its sets."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks.kills import FLOWN, ONE_SCAN, SMALL, VIEW, digests, untimed

pytestmark = pytest.mark.slow

ORBIT = ["--orbit", "0 0 -1 2 4 20"]
PHYSICAL = ["--model", "physical"]
COMMANDS = {
    "simulate": ["simulate", "tank", *VIEW, *ORBIT, "--truth"],
    "simulate physical": ["simulate", "tank", *VIEW, *PHYSICAL, *ORBIT],
    "dataset": ["dataset", "structures", *VIEW, "--count", "4", "--workers", "2"],
    "map": ["map", "recording.mcap", "--voxel", "0.25"],
    "map carving": ["map", "recording.mcap", "--voxel", "0.25", "--mapper", "carving"],
    "fly": ["fly", "tank", "--waypoints", "0 0 -1 0; 1 0 -1 0"],
    "scan": ["scan", "tetrapod", *SMALL, "--planner", "uniform", *ONE_SCAN],
    "scan --vehicle": ["scan", "tetrapod", *SMALL, *FLOWN, *ONE_SCAN],
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording in it."""
    place = tmp_path_factory.mktemp("recorded")
    _run(["scan", "tetrapod", *SMALL, *ONE_SCAN, "--planner", "uniform"], place, "whole")
    (place / "whole" / "recording.mcap").rename(place / "recording.mcap")
    return place


def _run(words: list[str], place: Path, out: str, number: str = "1") -> None:
    subprocess.run(
        [sys.executable, "-m", "insonify", *words, "--out", out],
        cwd=place,
        env=os.environ | {"NUMBA_NUM_THREADS": number, "PYTHONHASHSEED": number},
        check=True,
        capture_output=True,
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_threads_and_hash_seeds_change_nothing(name: str, recorded: Path) -> None:
    left = []
    for number in ("1", "2"):
        out = f"{name} {number}"
        _run(COMMANDS[name], recorded, out, number)
        left.append(untimed(digests(recorded / out)))
    assert left[0]
    assert left[0] == left[1]
