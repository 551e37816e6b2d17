"""Pings and poses that come one at a time: each ping leaves when the pose at its time is known.

The rules are those of recordings (`io.recordings.ros`), and so is the code: an `Index` of the last
half minute is kept, and a ping is decoded and posed by `posed_ping` as one of a bag is.  What a bag
tells by being read to its end is settled here when it has been listened to for a while, and then
holds: whose poses are the vehicle's, and where the sonar sits.

Pings leave in the order in which they came.  One whose pose does not come in time leaves without.
"""

from __future__ import annotations

import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.io.recordings.beams import PixelError
from insonify.io.recordings.recording import Reading, refuse_beams
from insonify.io.recordings.ros.bags import DAMAGE, Bag, BagMessage
from insonify.io.recordings.ros.frame_tree import FrameTree, stamp_ns
from insonify.io.recordings.ros.index import Index, namespace
from insonify.io.recordings.ros.pings import PingDecoder
from insonify.io.recordings.ros.recording import posed_ping, sonar_topic
from insonify.io.recordings.ros.whereabouts import Whereabouts, track_of, whereabouts
from insonify.live.counts import Counts
from insonify.types import PosedPing

BUS = Bag(Path("the bus"), "live", lambda topics: iter(()))
_UNTOLD = Whereabouts("none", "none: not told yet")
MOST_WAITING = 256
"""Pings that may wait for their poses; the oldest then leaves without."""
_MOST_LINKS = 20_000
"""Messages of TF kept until it is known which vehicle's they are."""
_REMEMBERED = 512
"""Pings among which one that comes again is told."""


@dataclass(frozen=True, slots=True)
class Patience:
    """How long is waited, by the clock on which messages come.

    Attributes:
        listen_s: From the first ping on, until it is settled whose poses are taken.
        wait_s: For the pose of a ping.
        window_s: What lies longer ago is forgotten.
    """

    listen_s: float = 2.0
    wait_s: float = 1.0
    window_s: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """What holds once it is known: of a bus when it has been listened to, of a bag beforehand.

    Attributes:
        topic: Of the pings.
        reading: What the user says, with the full scale of the pixels.
        poses: Where the vehicle's poses are found; its track is made anew for each ping.
        ours: Whether states of pings tell all of them.
        bounds: ``max_gap_s`` and ``fastest_mps`` of the poses' topic, if all of it is known.
        links: The same of each moving link of TF.
        spaces: Whose TF counts, by the first part of its topic; None if everybody's.
    """

    topic: str
    reading: Reading
    poses: Whereabouts
    ours: bool
    bounds: tuple[float | None, float | None] = (None, None)
    links: dict[str, tuple[float, float]] | None = None
    spaces: frozenset[str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Waiting:
    """A ping that waits for its pose: its message, when it came, and the time that it tells."""

    message: BagMessage
    came_ns: int
    stamp_ns: int


class Poser:
    """Takes messages, gives pings with their poses."""

    def __init__(
        self,
        reading: Reading,
        counts: Counts,
        settled: Settled | None = None,
        patience: Patience = Patience(),
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        """Nothing heard yet.

        Args:
            reading: What the user says of the sonar and its poses.
            counts: Told what happens to messages.
            settled: What is known beforehand.
            patience: How long is waited for what is not.
            clock: Nanoseconds; of a recording, whose messages alone tell the time, always 0.
        """
        self.reading, self.counts = reading, counts
        self._patience, self._clock = patience, clock
        self.index = Index(tree=self._empty_tree())
        self._known = settled
        self._settled: Settled | None = None
        self._decoder: PingDecoder | None = None
        self._spaces: frozenset[str] | None = None
        self._waiting: deque[Waiting] = deque()
        self._seen: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)
        self._now_ns = self._first_ns = self._tried_ns = self._forgot_ns = self._newest_ns = 0

    @property
    def is_settled(self) -> bool:
        """Whether it is settled which topics are meant."""
        return self._settled is not None

    @property
    def doubts(self) -> list[str]:
        """What had to be assumed."""
        poses = () if self._settled is None else self._settled.poses.doubts
        return [*poses, *([] if self._decoder is None else self._decoder.doubts)]

    @property
    def source(self) -> str:
        """Whose poses are taken, in words."""
        return "not settled yet" if self._settled is None else self._settled.poses.source

    @property
    def world(self) -> str:
        """The frame in which the vehicle's poses are told."""
        poses = _UNTOLD if self._settled is None else self._settled.poses
        if poses.topic:
            return self.index.worlds[poses.topic] or "map"
        return (self.index.tree.root_of(poses.frame)[0] if poses.frame else "") or "map"

    @property
    def waiting(self) -> int:
        """How many pings wait for their poses."""
        return len(self._waiting)

    def take(self, message: BagMessage) -> Iterator[tuple[Waiting, PosedPing]]:
        """Take a message; the pings that can leave now.

        Raises:
            RecordingError: Whose poses are meant is the user's to say, or what pixels mean.
        """
        self.counts.messages += 1
        self._now_ns = max(self._now_ns, message.time_ns)
        self._note(message)
        if self._settled is not None and self.index.links:
            self._hang()
        if message.topic in self.index.sonars and self._wanted(message.topic):
            self._hear(message)
        yield from self._leave()

    def tick(self) -> Iterator[tuple[Waiting, PosedPing]]:
        """The pings that can leave when nothing more has come until now."""
        self._now_ns = max(self._now_ns, self._clock())
        yield from self._leave()

    def finish(self) -> Iterator[tuple[Waiting, PosedPing]]:
        """All pings that still wait: no more messages will come."""
        if self._waiting and self._settled is None:
            self._try_to_settle(at_last=True)
        while self._waiting:
            yield from self._pose(self._waiting.popleft())

    def _empty_tree(self) -> FrameTree:
        tree = FrameTree(self.reading.max_gap_s)
        tree.window_s = self._patience.window_s
        return tree

    def _wanted(self, topic: str) -> bool:
        settled = self._settled or self._known
        told = self.reading.sonar_topic if settled is None else settled.topic
        return told is None or topic == told

    def _note(self, message: BagMessage) -> None:
        """Take what a message tells of poses; forget what is old."""
        index, counts = self.index, self.counts
        before = {topic: len(rows) for topic, rows in index.tracks.items()}
        undecoded = index.undecoded
        index.note(message)
        counts.damaged += index.undecoded - undecoded
        rows = index.tracks.get(message.topic, [])
        if len(rows) > before.get(message.topic, 0):
            counts.poses += 1
            self._order(message.topic, rows)
        if self._settled is None and len(index.links) > _MOST_LINKS:
            static = [one for one in index.links if "static" in one[0]]
            moving = [one for one in index.links if "static" not in one[0]]
            index.links = static[-_MOST_LINKS // 4 :] + moving[-_MOST_LINKS // 2 :]
        if self._now_ns - self._forgot_ns > 1_000_000_000:
            self._forgot_ns = self._now_ns
            index.forget(self._patience.window_s)

    def _order(self, topic: str, rows: list[list[float]]) -> None:
        """Note a pose that comes late; where a clock was set back, begin anew."""
        if len(rows) < 2 or rows[-1][0] >= rows[-2][0]:
            return
        self.counts.late_poses += 1
        if rows[-1][0] < rows[-2][0] - self._patience.window_s:
            self.counts.clock_resets += 1
            del rows[:-1]
            del self.index.spreads[topic][:-1]

    def _hang(self) -> None:
        """Put what TF tells since into the tree."""
        for topic, message in self.index.links:
            if self._spaces is None or namespace(topic) in self._spaces:
                self.index.hang(topic, message)
        self.index.links.clear()

    def _hear(self, message: BagMessage) -> None:
        """Let a ping wait for its pose, unless it has come before."""
        try:
            decoded = message.decode()
            stamp = stamp_ns(decoded.header) or message.time_ns
            mark = (stamp, zlib.crc32(np.ascontiguousarray(_pixels(decoded)).data))
        except DAMAGE:
            self.counts.damaged += 1
            return
        self.counts.pings += 1
        if mark in self._seen:
            self.counts.duplicates += 1
            return
        reset = stamp < self._newest_ns - 1e9 * self._patience.window_s
        if stamp < self._newest_ns and not reset:
            self.counts.out_of_order += 1
        if self._newest_ns and not reset:
            self.counts.note_gap(stamp - self._newest_ns)
        self._newest_ns = stamp if reset else max(self._newest_ns, stamp)
        self._seen.append(mark)
        self._first_ns = self._first_ns or self._now_ns
        whole = replace(message, decode=lambda: decoded)
        self._waiting.append(Waiting(whole, self._now_ns, stamp))

    def _leave(self) -> Iterator[tuple[Waiting, PosedPing]]:
        if self._waiting and self._settled is None and self._is_time():
            self._try_to_settle()
        wait_ns = round(1e9 * self._patience.wait_s)
        if self._settled is None:
            wait_ns += round(1e9 * self._patience.listen_s)
        while self._waiting:
            head = self._waiting[0]
            late = self._now_ns - head.came_ns > wait_ns or len(self._waiting) > MOST_WAITING
            if not (late or self._is_ready(head)):
                return
            yield from self._pose(self._waiting.popleft())

    def _is_time(self) -> bool:
        """Whether to look whose poses are meant: at once if all is told, else after listening."""
        if self._known is not None:
            return True
        exact = self.reading.pose_topic is None and self.reading.convention is None
        if exact and self._waiting[0].stamp_ns in self.index.states:
            return True
        since = self._tried_ns or self._first_ns
        return self._now_ns - since > 1e9 * self._patience.listen_s

    def _try_to_settle(self, *, at_last: bool = False) -> None:
        """Settle whose poses are taken, if anything tells.

        Raises:
            RecordingError: Several could be meant, or the pixels' full scale is not known.
        """
        self._tried_ns = self._now_ns
        index = self.index
        found = self._known or self._look()
        if found is None and at_last:
            found = Settled(sonar_topic(BUS, index, self.reading), self.reading, _UNTOLD, False)
        if found is None:
            return
        self._spaces = found.spaces
        index.tree = self._empty_tree()
        index.tree.bounds = dict(found.links or {})
        self._hang()
        self._decoder = PingDecoder(
            index.sonars[found.topic],
            found.poses.mount,
            found.reading,
            framed=found.poses.framed,
            ours=found.ours,
        )
        self._settled = replace(found, poses=replace(found.poses, track=None))
        self._waiting = deque(one for one in self._waiting if one.message.topic == found.topic)
        if not found.poses.exact:
            self._check_first()

    def _look(self) -> Settled | None:
        """Whose poses what was heard so far tells of; None if nothing does."""
        index, reading = self.index, self.reading
        topic = sonar_topic(BUS, index, reading)
        index.tree = self._empty_tree()
        index.settle(namespace(topic))
        if reading.pose_topic is not None and reading.pose_topic not in index.tracks:
            return None
        poses = whereabouts(BUS, index, topic, reading)
        if poses.source == "none":
            return None
        return Settled(
            topic,
            reading,
            poses,
            bool(index.states),
            (reading.max_gap_s, None),
            spaces=spaces_of(index, topic),
        )

    def _check_first(self) -> None:
        """Refuse what would be a guess of all pings to come.

        Raises:
            RecordingError: The pixels' full scale is not known, or columns of one beam are ordered.
        """
        assert self._settled is not None
        assert self._decoder is not None
        reading = self._settled.reading
        for head in self._waiting:
            decoded = head.message.decode()
            try:
                pixels = self._decoder.raw(decoded)
                ping = self._decoder.ping(decoded, 0.0)
            except PixelError as err:
                raise RecordingError(f"{self._settled.topic}: {err}") from err
            except DAMAGE:
                continue
            kind = pixels.dtype
            if reading.full_scale is None and kind.kind in "ui" and kind.itemsize > 1:
                raise RecordingError(
                    f"{self._settled.topic}: its pixels are {kind.name}, and which value means the "
                    f"loudest is not known before all of them are; say it (--scale "
                    f"{np.iinfo(kind).max}, for one)"
                )
            if ping.geometry.beams == 1:
                refuse_beams(Path(self._settled.topic), reading)
            return

    def _is_ready(self, head: Waiting) -> bool:
        """Whether all is heard that tells a ping's pose."""
        if self._settled is None:
            return False
        poses = self._settled.poses
        if poses.exact:
            return head.stamp_ns in self.index.states
        at_s = head.stamp_ns * 1e-9 + self._settled.reading.clock_offset_s
        told_s = [np.inf]
        if poses.topic:
            told_s.append(max(row[0] for row in self.index.tracks[poses.topic]))
        frames = [frame for frame in (poses.frame, poses.base) if frame]
        if poses.base:
            frames.append(str(head.message.decode().header.frame_id))
        if frames:
            told_s.append(self.index.tree.told_until_s(*frames))
        return bool(min(told_s) >= at_s)

    def _pose(self, head: Waiting) -> Iterator[tuple[Waiting, PosedPing]]:
        index = self.index
        decoder, reading, poses = self._decoder, self.reading, _UNTOLD
        if decoder is None:
            shape = index.sonars[head.message.topic]
            decoder = PingDecoder(shape, None, reading)
        if self._settled is not None:
            reading, poses = self._settled.reading, self._settled.poses
            if poses.topic:
                poses = replace(poses, track=track_of(index, poses.topic, *self._settled.bounds))
        try:
            posed = posed_ping(head.message, decoder, index, poses, reading)
        except (PixelError, *DAMAGE) as err:
            self.counts.damaged += 1
            self.counts.last_damage = reason(err)
            return
        self.counts.unposed += posed.pose is None
        yield head, posed


def spaces_of(index: Index, topic: str) -> frozenset[str] | None:
    """Whose TF counts for the sonar of a topic: `Index.settle`'s rule, for links yet to come."""
    vehicle = namespace(topic)
    known = {namespace(name) for name, _ in index.links}
    return frozenset({"", vehicle}) if vehicle in known else None


def _pixels(decoded: Any) -> Any:
    """What tells one ping from another with the same stamp."""
    if hasattr(decoded, "intensities"):
        return decoded.intensities
    picture = decoded.image if hasattr(decoded, "image") else decoded.ping
    return picture.data
