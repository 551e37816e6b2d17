"""Scans that were killed: found again by their scratch folder, and gone on with.

A scan writes its recording as it goes, beside its config, in the scratch folder of its result.  If
the process dies, the folder stays.  The same scan, started again, takes the pings from there.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from glob import escape
from pathlib import Path
from typing import Any

import psutil

from insonify.errors import RecordingError
from insonify.io.recordings import messages
from insonify.io.recordings.bag_recording import read_bag
from insonify.io.recordings.bags import DAMAGE, open_bag
from insonify.io.recordings.recording import Reading, Recording, RecordingWarning
from insonify.io.recordings.scans import STATES
from insonify.runs import Remembered

RECORDING, CONFIG, OWNER = "recording.mcap", "config.toml", "owner.pid"


@dataclass(frozen=True, slots=True)
class Unfinished:
    """The scratch folder of a scan whose process is gone."""

    folder: Path


def claim(folder: Path, config: str) -> None:
    """Write into a scratch folder whose it is, and of what config."""
    (folder / CONFIG).write_text(config, encoding="utf-8")
    started = psutil.Process().create_time()
    (folder / OWNER).write_text(f"{os.getpid()} {started!r}", encoding="utf-8")


def find_unfinished(target: Path, config: str) -> Unfinished | None:
    """The scratch folder of a dead scan of the same config to the same target, if there is one."""
    for folder in sorted(target.parent.glob(f".{escape(target.name)}-*")):
        try:
            same = (folder / CONFIG).read_text(encoding="utf-8") == config
            owner, started = (folder / OWNER).read_text(encoding="utf-8").split()
            if same and (folder / RECORDING).stat().st_size and not _lives(owner, started):
                return Unfinished(folder)
        except (OSError, ValueError):
            continue
    return None


def remembered(unfinished: Unfinished) -> tuple[int, Iterator[Remembered]]:
    """How many pings a dead scan's recording holds up to its last whole chunk, and they, in order.

    The folder must stay until the last is taken.
    """
    path = unfinished.folder / RECORDING
    with path.open("rb") as file:
        bag = open_bag(path, file.read(16))
    if bag is None:
        return 0, iter(())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # that it is cut off is why we are here
        try:
            states = _generators(bag.read({STATES}))
            recording = read_bag(bag, Reading())
        except RecordingError:
            return 0, iter(())
    return recording.count, _remembered(recording, states)


def _remembered(recording: Recording, states: dict[int, Any]) -> Iterator[Remembered]:
    for recorded in recording:
        words = states.get(round(recorded.ping.time_s * 1e9))
        if recorded.pose is None or words is None or len(words) != 6:
            return
        yield Remembered(recorded.pose, recorded.ping, partial(_set_noise, words=words))


def _set_noise(generator: Any, words: Any) -> None:
    messages.set_generator(generator, words)


def _generators(bag_messages: Iterator[Any]) -> dict[int, Any]:
    found = {}
    for message in bag_messages:
        try:
            found[message.time_ns] = message.decode().generator
        except DAMAGE:
            continue
    return found


def _lives(owner: str, started: str) -> bool:
    """Whether the process that wrote a folder is still the one of its number."""
    try:
        return bool(psutil.Process(int(owner)).create_time() == float(started))
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True
