"""The pings of a run from its recording, so that it can be gone on with."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from insonify.errors import RecordingError
from insonify.io.recordings.magic import MCAP_MAGIC
from insonify.io.recordings.recording import Reading, Recording, RecordingWarning
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.bags import DAMAGE, open_bag
from insonify.io.recordings.ros.recording import read_bag
from insonify.mission.run import Remembered
from insonify.results.files import RECORDING
from insonify.results.recorder import STATES


def remembered(folder: Path) -> tuple[int, Iterator[Remembered]]:
    """How many pings a scan's recording holds up to its last whole chunk, and they, in order.

    The folder must stay until the last is taken.
    """
    path = folder / RECORDING
    with path.open("rb") as file:
        head = file.read(16)
    if not head.startswith(MCAP_MAGIC):
        return 0, iter(())
    bag = open_bag(path, head)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # that it is cut off is why we are here
        try:
            states = _generators(bag.read({STATES}))
            recording = read_bag(bag, Reading())
        except RecordingError:
            return 0, iter(())
    return recording.count, _remembered(recording, states, str(folder))


def _remembered(recording: Recording, states: dict[int, Any], source: str) -> Iterator[Remembered]:
    for posed in recording:
        words = states.get(round(posed.ping.time_s * 1e9))
        if posed.pose is None or words is None or len(words) != 6:
            return
        yield Remembered(posed, partial(_set_noise, words=words), source)


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
