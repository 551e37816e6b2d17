"""A recording as a source of messages: those that are in it, or those that its pings would be.

A bag's own messages come in the order of the file; it has been read through before, so what holds
for it (`Settled`) is what `map` finds.  Of any other recording the pings become messages of ours,
which tell all of them unrounded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from insonify.io.recordings import open_bag_at, open_recording
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros.bags import DAMAGE, Bag, BagMessage
from insonify.io.recordings.ros.index import STATE, index_of, namespace
from insonify.io.recordings.ros.recording import scaled_pixels, sonar_topic
from insonify.io.recordings.ros.whereabouts import whereabouts
from insonify.io.recordings.ros.workspaces import learn
from insonify.live.counts import Counts
from insonify.live.poser import Poser, Settled, spaces_of
from insonify.results.replay import posed_messages, timed

SONAR = "sonar"
"""Of pings that were no messages: their topics and their frame."""
FREQUENCY_HZ, SOUND_SPEED_MPS = 1e6, 1500.0
"""Told of them; nothing reads it."""
_BEGIN_NS = 1_000_000_000
_LONGEST_SLEEP_S = 0.1


def ping_topics(name: str) -> dict[str, str]:
    """The topics of the pings of a sonar of a name, and their types."""
    return {
        "/tf": "tf2_msgs/msg/TFMessage",
        "/odometry": "nav_msgs/msg/Odometry",
        "/ground_truth/odometry": "nav_msgs/msg/Odometry",
        f"/{name}/state": STATE,
        f"/{name}/image": "marine_acoustic_msgs/msg/ProjectedSonarImage",
        f"/{name}/polar": "sensor_msgs/msg/Image",
    }


PING_TOPICS = ping_topics(SONAR)

Source = Iterator[BagMessage | None]
"""Messages as they come; None where nothing has come for a moment."""


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """A recording that can be played.

    Attributes:
        count: Pings in it.
        sonar: The topic of the pings.
        topics: All topics and their types.
        messages: Gives them all, in order.
        reading: What is left to be said of them.
        settled: What holds for them, if it is known.
        doubts: What had to be assumed.
    """

    count: int
    sonar: str
    topics: dict[str, str]
    messages: Callable[[], Iterator[BagMessage]]
    reading: Reading
    settled: Settled | None
    doubts: tuple[str, ...]

    def poser(self, counts: Counts) -> Poser:
        """Who poses its pings as `map` does, however slowly it is played."""
        return Poser(self.reading, counts, self.settled, clock=lambda: 0)


def open_played(path: Path, reading: Reading) -> Played:
    """Open a recording to play it.

    Raises:
        RecordingError: It cannot be read as a recording of pings.
    """
    recording = open_recording(path, reading)
    doubts = tuple(recording.facts.get("doubts", ()))
    bag = open_bag_at(path)
    if bag is not None and reading.poses is None:
        settled, topics = _settled(_teaching(bag), reading)
        return Played(
            recording.count,
            settled.topic,
            topics,
            lambda: bag.read(None),
            reading,
            settled,
            doubts,
        )

    def messages() -> Iterator[BagMessage]:
        shift_ns: int | None = None
        for now, posed in timed(recording):
            if shift_ns is None:  # a stamp of 0 means none
                shift_ns = 0 if now > 0 else _BEGIN_NS - now
            now += shift_ns
            told = posed_messages(SONAR, posed, now, FREQUENCY_HZ, SOUND_SPEED_MPS)
            for topic, message in told.items():
                yield as_message(topic, message, now)

    return Played(
        recording.count, f"/{SONAR}/image", PING_TOPICS, messages, Reading(), None, doubts
    )


def _teaching(bag: Bag) -> Bag:
    """A bag whose own types are known once it was read, so that they can be published."""

    def read(topics: Collection[str] | None) -> Iterator[BagMessage]:
        met: set[str] = set()
        for message in bag.read(topics):
            if message.kind not in met and message.types is not None:
                met.add(message.kind)
                with suppress(*DAMAGE):
                    learn(message.kind, message.types)
            yield message

    return replace(bag, read=read)


def as_message(topic: str, message: Any, now_ns: int) -> BagMessage:
    """A message that need not be decoded."""
    return BagMessage(topic, message.__msgtype__, now_ns, lambda: message)


def _settled(bag: Bag, reading: Reading) -> tuple[Settled, dict[str, str]]:
    """What holds for a bag, found as `read_bag` finds it; and its topics with their types."""
    index = index_of(bag, reading.max_gap_s)
    topic = sonar_topic(bag, index, reading)
    index.settle(namespace(topic))
    poses = whereabouts(bag, index, topic, reading)
    reading, _ = scaled_pixels(bag, index, topic, reading)
    bounds: tuple[float | None, float | None] = (None, None)
    if poses.track is not None:
        bounds = poses.track.max_gap_s, poses.track.fastest_mps
    settled = Settled(
        topic,
        reading,
        replace(poses, track=None),
        bool(index.states),
        bounds,
        index.tree.moving_bounds(),
        spaces_of(index, topic),
    )
    return settled, dict(index.counts.keys())


def paced(messages: Iterator[BagMessage], rate: float | None) -> Source:
    """Messages at the times between them, so many times as fast; at once if no rate is given."""
    begun: tuple[float, int] | None = None
    for message in messages:
        if rate is not None:
            begun = begun or (time.monotonic(), message.time_ns)
            due_s = begun[0] + (message.time_ns - begun[1]) * 1e-9 / rate
            while (left_s := due_s - time.monotonic()) > 0.0:
                time.sleep(min(left_s, _LONGEST_SLEEP_S))
                if left_s > _LONGEST_SLEEP_S:
                    yield None
        yield message
