"""What a session sends back: the map near the vehicle, the next scan's path, its health.

Topics: ``/insonify/map`` and, on request, ``/insonify/entropy`` (PointCloud2), ``/insonify/path``
(nav_msgs/Path), ``/diagnostics`` (DiagnosticArray); requests are words on ``/insonify/request``
(std_msgs/String): ``map``, ``entropy``, ``path``.  A path without poses says that there is none to
fly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from insonify.errors import InsonifyError
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.bags import DAMAGE, BagMessage
from insonify.live.health import OK, WARN, Health
from insonify.live.planning import Answer, Desk, Pilot
from insonify.live.session import Event, Finished, Heard, Planned, Session
from insonify.mapping.voxels import Blocks, VoxelMap, Voxels, probability_from_log_odds
from insonify.planning.entropy import binary_entropy
from insonify.types import Array, Bool, Box, Float64, Pose

MAP, ENTROPY, PATH = "/insonify/map", "/insonify/entropy", "/insonify/path"
REQUEST, DIAGNOSTICS = "/insonify/request", "/diagnostics"
ANSWERS = {
    MAP: "sensor_msgs/msg/PointCloud2",
    ENTROPY: "sensor_msgs/msg/PointCloud2",
    PATH: "nav_msgs/msg/Path",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
REQUESTS = ("map", "entropy", "path")
_MOST_SHARE = 0.05
"""Of the time, for sending the map; pings wait for it."""

Send = Callable[[str, Any], None]
"""Sends a message on a topic."""


@dataclass(slots=True, eq=False)
class Publisher:
    """Sends what a session has made (a watcher of it).

    Attributes:
        send: Where to: the bus, Foxglove, or nowhere.
        pilot: Plans the next scan; None if paths are not sent.
        radius_m: How far from the vehicle the map is sent.
        every_s: How often map and health are, at most; a map that takes long is sent less often,
            and one that has not changed is not.
        desk: Where paths are planned; those that a recording asks for at once.
        plans_at_end: Whether to plan the next scan when all is heard too.
        words: What was last decided, for people.
        listens: Whether anybody listens to a topic; a map for nobody is not made.
    """

    send: list[Send]
    pilot: Pilot | None = None
    radius_m: float = 20.0
    every_s: float = 1.0
    desk: Desk = field(default_factory=Desk)
    plans_at_end: bool = False
    words: str = ""
    listens: Callable[[str], bool] = lambda topic: True
    _pose: Pose | None = None
    _stamp_ns: int = 0
    _answered: tuple[int, Any] | None = None
    _map_due_s: float = 0.0
    _health_due_s: float = 0.0
    _shown_ns: int = -1
    _fares: Health = field(default_factory=Health)
    _asked: list[str] = field(default_factory=list)
    _held: bool = False
    _missed: tuple[int, int] = (0, 0)

    def requests_heard(self, source: Iterable[BagMessage | None]) -> Iterator[BagMessage | None]:
        """A source without its requests, which are answered."""
        for message in source:
            yield None if message is None or self.hears(message) else message

    def hears(self, message: BagMessage) -> bool:
        """Whether a message is a request; it is answered at the next event."""
        if message.topic != REQUEST:
            return False
        with suppress(*DAMAGE):
            word = str(message.decode().data).strip()
            if word in REQUESTS:
                self._asked.append(word)
        return True

    def watch(self, session: Session, event: Event) -> None:
        """Send what is due."""
        self._fares.watch(session, event)
        if isinstance(event, Heard):
            self._stamp_ns = event.stamp_ns
            self._follow(session, event)
        if isinstance(event, Planned):
            return
        self._answer_requests(session)
        self._take_plan(session, wait=isinstance(event, Finished))
        if isinstance(event, Finished) and self.plans_at_end and self._is_news():
            self.plan(session)
        if not self.send:
            return
        ended, now_s = isinstance(event, Finished), time.monotonic()
        if ended or now_s > self._map_due_s:
            if self._shown_ns != self._stamp_ns and self.listens(MAP):
                self._map(session)
            took_s = time.monotonic() - now_s
            self._map_due_s = now_s + max(self.every_s, took_s / _MOST_SHARE)
        if ended or now_s > self._health_due_s:
            self._health_due_s = now_s + self.every_s
            self._health(session)

    def plan(self, session: Session) -> None:
        """Plan the next scan's path, which is sent when it is planned; the same if nothing came."""
        if self.pilot is None:
            self.words = "a path was asked for, and none are sent (--plan)"
            return
        if self.desk.busy:
            self._held = True
            return
        if self._answered is not None and not self._is_news():
            session.counts.paths_sent += 1
            self._say(PATH, self._answered[1])
            return
        if self._pose is None or not session.remap.fans:
            self._answer(session, self._stamp_ns, Answer(None, "nothing is mapped yet"))
            return
        remap = session.remap
        try:
            asked = self.pilot.question(remap.mapper, remap.fans[-1], self._pose, self._stamp_ns)
        except InsonifyError as err:
            self._answer(session, self._stamp_ns, Answer(None, str(err)))
            return
        self.desk.plan(self.pilot, asked)
        self._take_plan(session)

    def _is_news(self) -> bool:
        """Whether a ping has come since a path was answered."""
        return self._answered is None or self._answered[0] != self._stamp_ns

    def _answer_requests(self, session: Session) -> None:
        """Answer what was asked for since; the map once, however often."""
        asked, self._asked = self._asked, []
        session.counts.paths_asked += asked.count("path")
        if self.desk.busy:
            session.counts.paths_held += asked.count("path")
        for word in dict.fromkeys(asked):
            {"map": self._map, "entropy": self._entropy, "path": self.plan}[word](session)

    def _take_plan(self, session: Session, *, wait: bool = False) -> None:
        """Send what is planned by now; then plan again if that was asked for, and pings came."""
        taken = self.desk.take(wait=wait)
        if taken is None or self.pilot is None:
            return
        question, answer = taken
        self.pilot.sends(answer)
        self._answer(session, question.stamp_ns, answer)
        held, self._held = self._held, False
        if held and self._is_news() and not wait:
            self.plan(session)

    def _answer(self, session: Session, stamp_ns: int, answer: Answer) -> None:
        """Send a path; one without poses if there is none to fly."""
        self.words = f"next scan: {answer.why}" if answer.path else f"no next scan: {answer.why}"
        origin = session.remap.mapper.voxels.origin_m
        world = tuple(pose.moved(origin) for pose in answer.waypoints)
        path = messages.path(world, stamp_ns, session.poser.world)
        self._answered = stamp_ns, path
        session.counts.paths_sent += 1
        self._say(PATH, path)
        sent = 0 if self.pilot is None else self.pilot.sent
        session.tell(Planned(answer, stamp_ns, sent))

    def _say(self, topic: str, message: Any) -> None:
        for send in self.send:
            send(topic, message)

    def _follow(self, session: Session, event: Heard) -> None:
        """Note where the vehicle is; at the end of a scan that was sent, send the next."""
        if event.posed.pose is None:
            return
        self._pose = event.posed.pose.relative_to(session.remap.mapper.voxels.origin_m)
        if self.pilot is not None and self.pilot.flown(self._pose):
            self.plan(session)

    def _map(self, session: Session) -> None:
        self._shown_ns = self._stamp_ns
        points = occupied_near(session.remap.mapper.voxels, self._pose, self.radius_m)
        names = ("x", "y", "z", "probability")
        self._say(MAP, messages.point_cloud(points, names, self._stamp_ns, session.poser.world))

    def _entropy(self, session: Session) -> None:
        points = undecided_near(session.remap.mapper.voxels, self._pose, self.radius_m)
        names = ("x", "y", "z", "entropy")
        self._say(ENTROPY, messages.point_cloud(points, names, self._stamp_ns, session.poser.world))

    def _health(self, session: Session) -> None:
        told = session.counts.to_json() | {
            "waiting": session.poser.waiting,
            "poses from": session.poser.source,
            "blocks": session.remap.mapper.voxels.block_count,
            "planning": self.desk.busy,
        }
        level, words = self._fares.state(session)
        missed = session.counts.lost, session.counts.overwritten
        lost, overwritten = np.subtract(missed, self._missed)
        self._missed = missed
        if level == OK and (lost or overwritten):
            level = WARN
            words = f"since the last time, the bus lost {lost} messages and {overwritten} were "
            words += "overwritten"
        elif level == OK:
            words = self.words or "mapping"
        values = [
            messages.new("diagnostic_msgs/KeyValue", key=key, value=str(value))
            for key, value in told.items()
        ]
        status = messages.new(
            "diagnostic_msgs/DiagnosticStatus",
            level=level, name="insonify: live", message=words, hardware_id="", values=values,
        )  # fmt: skip
        header = messages.header(time.time_ns(), "")
        self._say(
            DIAGNOSTICS,
            messages.new("diagnostic_msgs/DiagnosticArray", header=header, status=[status]),
        )


def occupied_near(voxels: VoxelMap, pose: Pose | None, radius_m: float) -> Float64:
    """Occupied voxels around a pose (N, 4): x, y, z in the world, probability."""
    if pose is None:
        return np.zeros((0, 4))
    occupied = voxels.select(box=_around(pose, radius_m))
    return _rows(voxels, occupied, probability_from_log_odds(occupied.log_odds), pose, radius_m)


def undecided_near(
    voxels: VoxelMap, pose: Pose | None, radius_m: float, least_bits: float = 0.5
) -> Float64:
    """Voxels in view of high entropy around a pose (N, 4): x, y, z in the world, bits."""
    if pose is None:
        return np.zeros((0, 4))

    def doubtful(part: Blocks) -> Bool:
        bits = binary_entropy(probability_from_log_odds(part.log_odds))
        return np.asarray((part.seen > 0) & (bits >= least_bits), bool)

    found = voxels.select(doubtful, _around(pose, radius_m))
    bits = binary_entropy(probability_from_log_odds(found.log_odds))
    return _rows(voxels, found, bits, pose, radius_m)


def _around(pose: Pose, radius_m: float) -> Box:
    return Box.of(pose.position_m, pose.position_m).grown(radius_m)


def _rows(voxels: VoxelMap, found: Voxels, values: Array, pose: Pose, radius_m: float) -> Float64:
    places = voxels.centres_m(found)
    near = np.linalg.norm(places - pose.position_m, axis=1) <= radius_m
    return np.column_stack([places[near] + voxels.origin_m, values[near]])
