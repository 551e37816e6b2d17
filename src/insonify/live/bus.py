"""The robot's bus: DDS as ROS 2 speaks it, without ROS.

Topics have ROS 2's prefix ``rt/`` and types its names ``pkg::msg::dds_::Name_``; types are made of
the definitions that recordings have.  Messages cross as they are serialised (CDR), decoded by
rosbags as those of a bag are.  ``ROS_DOMAIN_ID`` says which domain, ``CYCLONEDDS_URI`` which
interfaces and peers.

Readers are made when a writer of a kind that is wanted is found, and ask for no more than it
offers: best effort where it is, what was said before where it keeps that.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from types import TracebackType
from typing import Any, Self, cast

from rosbags.interfaces import Nodetype

from insonify.doctor import domain_of
from insonify.errors import ConfigError
from insonify.extras import require
from insonify.io.recordings.ros.bags import BagMessage
from insonify.io.recordings.ros.messages import message_types
from insonify.io.recordings.ros.pings import sonar_shape
from insonify.io.recordings.ros.workspaces import fields_of

require("live", "Programs on the robot's bus", "cyclonedds")

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication  # noqa: E402
from cyclonedds.core import DDSException, Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct, make_idl_struct  # noqa: E402
from cyclonedds.idl import types as idl  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

from insonify.live.inbox import Inbox  # noqa: E402

PREFIX = "rt"
LARGE_DEPTH, SMALL_DEPTH = 64, 1000
"""Messages of pings, and of anything else, that wait until they are taken; then the oldest go."""
_TAKEN = 8
"""Pings of a topic that are taken at once.  All else that has come is, so that when pings queue up
their poses and states, which are more and take no time, do not fall behind them."""
_WAIT_S = 0.1
_FOUND, _MOST_FOUND = "", 10_000
"""The name of what is found on the bus, which no topic has, and how much of it waits."""
_PLAIN = {
    "bool": bool,
    "byte": idl.uint8,
    "octet": idl.uint8,
    "char": idl.uint8,
    "string": str,
    **{name: getattr(idl, name) for name in ["int8", "int16", "int32", "int64"]},
    **{name: getattr(idl, name) for name in ["uint8", "uint16", "uint32", "uint64"]},
    **{name: getattr(idl, name) for name in ["float32", "float64"]},
}


@dataclass(frozen=True, slots=True, eq=False)
class BusMessage(BagMessage):
    """A message of the bus; ``time_ns`` is when it came, ``sent_ns`` when it was sent."""

    sent_ns: int = 0


class Serialised:
    """A message as bytes; DDS looks for no more than this in a sample."""

    def __init__(self, cdr: bytes) -> None:
        """Of its bytes."""
        self.cdr = cdr
        self.sample_info: Any = None


class Bus:
    """A participant of the bus."""

    def __init__(self) -> None:
        """Join the domain that the environment names.

        Raises:
            ConfigError: It names none, or it cannot be joined.
        """
        self.domain = domain_of(os.environ.get("ROS_DOMAIN_ID", ""))
        try:
            self._participant = DomainParticipant(self.domain)
        except DDSException as err:
            raise ConfigError(
                f"DDS domain {self.domain} cannot be joined ({err.msg}); check CYCLONEDDS_URI and "
                "the network's interfaces (`insonify doctor`)"
            ) from err
        self._inbox = Inbox(self._participant)
        found = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._inbox.read(_FOUND, found, _MOST_FOUND)
        self._heard: dict[str, tuple[str, tuple[bool, bool]]] = {}
        self._writers: dict[str, DataWriter[Any]] = {}

    @property
    def lost(self) -> int:
        """Messages that did not come, of those that DDS knows of."""
        return self._inbox.lost

    @property
    def overwritten(self) -> int:
        """Messages that came, and made room for later ones before they were taken."""
        return self._inbox.overwritten

    @property
    def topics(self) -> tuple[str, ...]:
        """What is read."""
        return tuple(sorted(self._heard))

    def publish(self, topic: str, message: Any, *, latched: bool = False) -> None:
        """Send a message; a topic is opened by its first one.

        Args:
            topic: With its slash before.
            message: Of a type that recordings have.
            latched: Whether who joins later is told the last one.
        """
        writer = self.writer(topic, message.__msgtype__, latched=latched)
        kind = _type(message.__msgtype__)
        sample: Any = object.__new__(kind)
        sample.cdr = bytes(message_types().serialize_cdr(message, message.__msgtype__))
        writer.write(sample)

    def writer(self, topic: str, kind: str, *, latched: bool = False) -> DataWriter[Any]:
        """The writer of a topic, opened when first asked for."""
        if topic not in self._writers:
            quality = _quality(reliable=True, latched=latched, depth=1 if latched else LARGE_DEPTH)
            self._writers[topic] = DataWriter(
                self._participant, self._topic(topic, kind), qos=quality
            )
        return self._writers[topic]

    def listeners(self, topic: str) -> int:
        """How many read a topic that is written."""
        return len(self._writers[topic].get_matched_subscriptions())

    def messages(
        self, wanted: Callable[[str, str], bool], idle_s: float = float("inf")
    ) -> Iterator[BagMessage | None]:
        """Messages as they come, those that have waited in the order of sending.

        Args:
            wanted: Whether a topic of a type is; asked once for each that is found.
            idle_s: It ends when nothing has come for so long.

        Yields:
            Messages, and None where none has come for a moment.
        """
        last_s = time.monotonic()
        while True:
            came = self.poll(wanted, _WAIT_S)
            yield from came
            if came:
                last_s = time.monotonic()
            else:
                yield None
                if time.monotonic() - last_s > idle_s:
                    return

    def poll(self, wanted: Callable[[str, str], bool], wait_s: float = 0.0) -> Sequence[BagMessage]:
        """What has come, some of each topic, after a wait for something to come."""
        self._inbox.wait(wait_s)
        self._discover(wanted)
        return self._take()

    def close(self) -> None:
        """Leave."""
        self._inbox.close()
        self._heard.clear()
        self._writers.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _topic(self, topic: str, kind: str) -> Topic[Any]:
        return Topic(self._participant, f"{PREFIX}{topic}", _type(kind))

    def _discover(self, wanted: Callable[[str, str], bool]) -> None:
        """Read what has begun to be written."""
        for found, _ in self._inbox.take(_FOUND, _MOST_FOUND):
            name, kind = str(found.topic_name), _kind(str(found.type_name))
            topic = name.removeprefix(PREFIX)
            heard = name.startswith(f"{PREFIX}/") and topic not in self._writers
            if not heard or not wanted(topic, kind) or fields_of(kind) is None:
                continue
            offered = (
                Policy.Reliability.BestEffort not in found.qos,
                Policy.Durability.TransientLocal in found.qos,
            )
            self._read(topic, kind, offered)

    def _read(self, topic: str, kind: str, offered: tuple[bool, bool]) -> None:
        """Read a topic as all of its writers offer it; reliable, and told what was said before."""
        if topic in self._heard:
            _, asked = self._heard[topic]
            offered = (offered[0] and asked[0], offered[1] and asked[1])
            if offered == asked:
                return
        depth = LARGE_DEPTH if _is_large(kind) else SMALL_DEPTH
        quality = _quality(reliable=offered[0], latched=offered[1], depth=0)
        reader = DataReader(self._participant, self._topic(topic, kind), qos=quality)
        self._heard[topic] = kind, offered
        self._inbox.read(topic, reader, depth)

    def _take(self) -> list[BusMessage]:
        came: list[BusMessage] = []
        for topic, (kind, _) in self._heard.items():
            for sample, now_ns in self._inbox.take(
                topic, _TAKEN if _is_large(kind) else SMALL_DEPTH
            ):
                sent_ns = int(sample.sample_info.source_timestamp)
                decode = _decoder(sample.cdr, kind)
                came.append(BusMessage(topic, kind, now_ns, decode, sent_ns=sent_ns))
        return sorted(came, key=lambda one: one.sent_ns)


def _decoder(cdr: bytes, kind: str) -> Callable[[], Any]:
    return lambda: message_types().deserialize_cdr(cdr, kind)


def _is_large(kind: str) -> bool:
    """Whether messages of a type are pings."""
    return sonar_shape(kind, fields_of(kind)) is not None


def _kind(name: str) -> str:
    """``pkg/msg/Name`` of ``pkg::msg::dds_::Name_``."""
    return name.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


def _quality(*, reliable: bool, latched: bool, depth: int) -> Qos:
    """What a reader asks for or a writer offers; all is kept if no depth is given."""
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100))
        if reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth) if depth else Policy.History.KeepAll,
    )


@cache
def _type(kind: str) -> type[Any]:
    """A message's type, whose samples are bytes."""

    def deserialize(data: bytes, **options: Any) -> Serialised:
        return Serialised(data)

    def serialize(sample: Any, **options: Any) -> bytes:
        return bytes(sample.cdr)

    made: Any = _struct(kind)
    made.deserialize = staticmethod(deserialize)
    made.deserialize_key = staticmethod(deserialize)
    made.serialize = serialize
    return made  # type: ignore[no-any-return]


@cache
def _struct(kind: str) -> type[IdlStruct]:
    package, _, short = kind.split("/")
    _, told = message_types().fielddefs[kind]
    fields = {name: _field(one) for name, one in told}
    return make_idl_struct(short, f"{package}::msg::dds_::{short}_", fields)


def _field(told: Any) -> Any:
    node, inside = told
    if node is Nodetype.BASE:
        return _PLAIN[inside[0]]
    if node is Nodetype.NAME:
        return _struct(inside)
    of, length = inside
    array, sequence = cast(Any, idl.array), cast(Any, idl.sequence)
    return array[_field(of), length] if node is Nodetype.ARRAY else sequence[_field(of)]
