"""The long searches for faults, in short: `python -m benchmarks.hostile` and `.kills`."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks.crafted import MAKERS

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[1]


def _module(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", *words], capture_output=True, text=True, cwd=ROOT, check=False,
        env=os.environ,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_crafted_files_end_well_or_in_one_sentence() -> None:
    assert "18 inputs, 0 failures" in _module("benchmarks.hostile", "--count", "18", "--seed", "7")


def test_kills_leave_old_or_new() -> None:
    told = _module("benchmarks.kills", "--count", "2", "--only", "export .bt")
    assert "0 faults" in told.splitlines()[-1]


@pytest.mark.parametrize("reader", MAKERS)
def test_an_input_is_known_by_its_number(
    reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        words = MAKERS[reader](random.Random(f"{reader} 0 3"))
        files = {path.name: path.read_bytes() for path in Path().iterdir() if path.is_file()}
        made.append((words, {k: v for k, v in files.items() if reader != "npz"}))
    assert made[0] == made[1]
