"""A session on the bus: what is read of it, and what goes back."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from insonify.errors import ConfigError
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros.bags import BagMessage
from insonify.io.recordings.ros.index import KINDS, STATE, TF
from insonify.io.recordings.ros.pings import sonar_shape
from insonify.io.recordings.ros.workspaces import PREFIXES, fields_of
from insonify.live.bus import Bus
from insonify.live.poser import Poser
from insonify.live.publishing import REQUEST, Publisher
from insonify.live.session import Event, Session

_LOOK_S, _MOMENT_S = 0.05, 1.5


def wanted_by(
    reading: Reading, is_settled: Callable[[], bool] = lambda: False
) -> Callable[[str, str], bool]:
    """Which topics a session reads: pings, poses and TF, requests; those the user chose, if any.

    A topic of pings that cannot be decoded is refused, unless it is settled that another is mapped.
    """

    def wanted(topic: str, kind: str) -> bool:
        name, fields = kind.rsplit("/", 1)[-1], fields_of(kind)
        if sonar_shape(kind, fields) is not None:
            meant = reading.sonar_topic in (None, topic)
            if meant and fields is None and not is_settled():
                raise ConfigError(
                    f"{topic} has pings of the type {kind}, whose definition is not known here; "
                    f"source the ROS workspace that has it ({PREFIXES}), or name another topic "
                    "(--sonar-topic)"
                )
            return meant
        if name in KINDS:
            return reading.pose_topic in (None, topic)
        return kind == STATE or name.lower() == TF or topic == REQUEST

    return wanted


def heard(
    bus: Bus, poser: Poser, publisher: Publisher, idle_s: float
) -> Iterator[BagMessage | None]:
    """The bus as a source of a session; requests go to the publisher.

    Raises:
        ConfigError: There are pings whose type nobody knows.
    """
    wanted = wanted_by(poser.reading, lambda: poser.is_settled)
    return publisher.requests_heard(bus.messages(wanted, idle_s))


def counting_losses(bus: Bus) -> Callable[[Session, Event], None]:
    """A watcher that notes what the bus has lost, or had no room for."""

    def watch(session: Session, event: Event) -> None:
        session.counts.lost, session.counts.overwritten = bus.lost, bus.overwritten

    return watch


def publish_all(
    bus: Bus,
    messages: Iterator[BagMessage | None],
    should_stop: Callable[[], bool],
    told: Callable[[int], None],
) -> tuple[int, dict[str, str]]:
    """Send a source's messages, with the clock they are told by.

    Returns:
        How many were sent; and the topics that could not be, with their types, which nobody knows.
    """
    sent, unknown = 0, {}
    for message in messages:
        if should_stop():
            break
        if message is None:
            continue
        if fields_of(message.kind) is None:
            unknown[message.topic] = message.kind
            continue
        decoded: Any = message.decode()
        bus.publish(message.topic, decoded, latched="static" in message.topic)
        sent += 1
        told(sent)
    return sent, unknown


def await_listener(
    bus: Bus,
    topics: Mapping[str, str],
    needed: str,
    wait_s: float,
    should_stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Open topics, and wait until one that is needed is listened to; whether it is.

    The others are then given a moment to be found too, since what is sent before is lost.  Those of
    types that nobody knows are left out.
    """
    topics = {topic: kind for topic, kind in topics.items() if fields_of(kind) is not None}
    for topic, kind in topics.items():
        bus.writer(topic, kind, latched="static" in topic)
    until_s = time.monotonic() + wait_s
    while not bus.listeners(needed):
        if should_stop() or time.monotonic() > until_s:
            return False
        time.sleep(_LOOK_S)
    until_s = time.monotonic() + _MOMENT_S
    while not all(map(bus.listeners, topics)) and time.monotonic() < until_s:
        time.sleep(_LOOK_S)
    return True
