"""A session: messages in, a map that grows, and whoever looks on told of it.

`Session` is the `mission.loop` of a robot that is not ours: it maps what comes by the same steps as
`mission.remap`.  Recording, keeping what a crash must not lose, publishing and showing are watchers
outside it, each called with what has happened.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from insonify.errors import GeometryError, MemoryLimitError
from insonify.io.recordings.ros.bags import BagMessage
from insonify.live.counts import Counts
from insonify.live.planning import Answer
from insonify.live.poser import Poser, Waiting
from insonify.mission.remap import Remap, map_ping
from insonify.planning.once import turns_of
from insonify.types import PosedPing

MOST_POSES = 50_000
"""Of the way that is drawn; beyond, every other is dropped."""
KEPT_PINGS = 6
"""For the report; while a session goes on, up to twice as many."""
MOST_PLANS = 200
"""Of which the account tells."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A path was asked for, and has been answered.

    The answer is told in the map's frame, of the map up to the ping of the stamp; ``scans`` were
    sent by then, this one counted.
    """

    answer: Answer
    stamp_ns: int
    scans: int


Event = Heard | Tick | Finished | Planned
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
        self.plans: deque[Planned] = deque(maxlen=MOST_PLANS)
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
            self._map(self.poser.tick())
        else:
            self._map(self.poser.take(message))
        if message is None or time.monotonic() - self._ticked_s >= TICK_S:
            self._ticked_s = time.monotonic()
            self.tell(Tick())

    def finish(self) -> None:
        """Map what still waits, and end."""
        self._map(self.poser.finish())
        self.remap.mapper.finish_scan()
        self.tell(Finished())

    def tell(self, event: Event) -> None:
        """Tell the watchers of something; a plan is kept for the account too."""
        if isinstance(event, Planned):
            self.plans.append(event)
        for watcher in self.watchers:
            watcher(self, event)

    def plans_told(self) -> list[dict[str, Any]]:
        """The last plans in the world's coordinates: where the way and the scan turn, and why."""
        origin_m = self.remap.mapper.voxels.origin_m
        return [
            {
                "stamp_ns": one.stamp_ns,
                "why": one.answer.why,
                "waypoints": [
                    [
                        *(round(c, 4) for c in pose.moved(origin_m).position_m),
                        round(math.degrees(pose.yaw_rad), 4),
                    ]
                    for pose in (turns_of(one.answer.waypoints) if one.answer.waypoints else ())
                ],
            }
            for one in self.plans
        ]

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
            self.tell(Heard(posed, waiting.stamp_ns))

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
