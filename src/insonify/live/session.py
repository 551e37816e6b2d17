"""A session: messages in, a map that grows, and whoever looks on told of it.

`Session` is the `mission.loop` of a robot that is not ours: it maps what comes by the same steps as
`mission.remap`.  Recording, keeping what a crash must not lose, publishing and showing are watchers
outside it, each called with what has happened.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from insonify.errors import GeometryError, MemoryLimitError
from insonify.io.recordings.ros.bags import BagMessage
from insonify.live.counts import Counts
from insonify.live.poser import Poser, Waiting
from insonify.mission.remap import Remap, map_ping
from insonify.types import PosedPing

MOST_POSES = 50_000
"""Of the way that is drawn; beyond, every other is dropped."""
KEPT_PINGS = 6
"""For the report; while a session goes on, up to twice as many."""
TICK_S = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """A ping has left the queue: mapped, if it has a pose that the map can hold.

    ``posed`` is told in the world, and without a pose where it was not mapped; the stamp is its
    own.
    """

    posed: PosedPing
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Tick:
    """A moment has passed, with messages or without."""


@dataclass(frozen=True, slots=True)
class Finished:
    """No more messages come."""


Event = Heard | Tick | Finished
Watcher = Callable[["Session", Event], None]


class Session:
    """Maps pings as they come."""

    def __init__(self, poser: Poser, remap: Remap, watchers: Iterable[Watcher] = ()) -> None:
        """Go on with a map, empty or not.

        Args:
            poser: Gives pings their poses.
            remap: The map, and what is known of how it came about.
            watchers: Told of every event, in this order.
        """
        self.poser, self.remap = poser, remap
        self.watchers = list(watchers)
        self.number = 0
        self._stride = 1
        self._ticked_s = time.monotonic()

    @property
    def counts(self) -> Counts:
        """What happened to messages."""
        return self.poser.counts

    def take(self, message: BagMessage | None) -> None:
        """Take a message, or None where nothing has come for a moment.

        Raises:
            RecordingError: Something of the recording or the bus is the user's to say.
        """
        if message is None:
            self._map(self.poser.tick(time.time_ns()))
        else:
            self._map(self.poser.take(message))
        if time.monotonic() - self._ticked_s >= TICK_S:
            self._ticked_s = time.monotonic()
            self._tell(Tick())

    def finish(self) -> None:
        """Map what still waits, and end."""
        self._map(self.poser.finish())
        self.remap.mapper.finish_scan()
        self._tell(Finished())

    def _map(self, pings: Iterable[tuple[Waiting, PosedPing]]) -> None:
        for waiting, told in pings:
            posed = told
            try:
                moved = map_ping(self.remap, told, waiting.message.topic)
            except (GeometryError, MemoryLimitError) as err:
                self.counts.refused += 1
                self.counts.last_damage = str(err)
                moved = posed = PosedPing(told.ping)
            self.number += 1
            if moved.pose is not None:
                self.counts.mapped += 1
                self._keep(moved)
                self._time(waiting)
            self._tell(Heard(posed, waiting.stamp_ns))

    def _keep(self, moved: PosedPing) -> None:
        """Keep some pings and the way for pictures, evenly, however many come."""
        if len(self.remap.poses) > MOST_POSES:
            del self.remap.poses[:-1:2]
        kept = self.remap.keyframes
        if self.counts.mapped % self._stride == 0:
            kept.append(("live", self.number, moved))
        if len(kept) > 2 * KEPT_PINGS:
            del kept[::2]
            self._stride *= 2

    def _time(self, waiting: Waiting) -> None:
        sent_ns = getattr(waiting.message, "sent_ns", 0)
        if sent_ns:
            self.counts.latencies_s.append((time.time_ns() - sent_ns) * 1e-9)

    def _tell(self, event: Event) -> None:
        for watcher in self.watchers:
            watcher(self, event)


def follow(
    session: Session,
    source: Iterable[BagMessage | None],
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Take a source's messages until it ends, or is to stop.

    Raises:
        RecordingError: Something is the user's to say.
    """
    for message in source:
        session.take(message)
        if should_stop():
            break
    session.finish()
