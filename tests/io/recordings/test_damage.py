"""A small run of ``python -m benchmarks.fuzz``: damaged files of every kind, and its own judge."""

from __future__ import annotations

import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from benchmarks import fuzz
from benchmarks.bag_samples import plain_bag

from insonify.errors import RecordingError
from insonify.io.recordings import open_recording

pytestmark = pytest.mark.slow


def test_damaged_files_are_read_in_part_or_refused_in_a_sentence() -> None:
    tallies = fuzz.fuzz(20 * len(fuzz.READERS), seed=1)
    assert {name: tally.failures for name, tally in tallies.items() if tally.failures} == {}
    assert all(sum(tally.outcomes.values()) == 20 for tally in tallies.values())


def _raise(error: BaseException) -> object:
    raise error


def _memory() -> object:
    try:
        return bytearray(2 * fuzz.MOST_BYTES)
    except MemoryError as err:
        raise RecordingError("damaged") from err


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda: _raise(KeyError("x")), "KeyError"),
        (lambda: _raise(RecordingError("two\nlines")), "not one sentence"),
        (_memory, "too much memory"),
        (lambda: time.sleep(10), "not enough"),
    ],
)
def test_the_judge_sees_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: object, words: str
) -> None:
    monkeypatch.setattr(fuzz, "MOST_SECONDS", 1)
    tally = fuzz.Tally()
    reader = fuzz.Reader("r", lambda folder, rng: folder, lambda path: read())  # type: ignore[operator]
    fuzz.try_one(reader, tmp_path / "f", b"x", tally)
    assert words in tally.failures[0]


def test_lengths_in_a_ros_1_bag_are_checked_before_they_are_believed(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    path = plain_bag(tmp_path / "b", "ros1", rng)
    raw = bytearray(path.read_bytes())
    struct.pack_into("<I", raw, 13, 0xFFFFFF00)  # the bag header's own length
    path.write_bytes(bytes(raw))
    with pytest.raises(RecordingError, match="beyond the end of the file"):
        open_recording(path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="neither a file nor a folder"):
        open_recording(tmp_path / "pipe")
    (tmp_path / "empty").write_bytes(b"")
    with pytest.raises(RecordingError, match="empty"):
        open_recording(tmp_path / "empty")
