"""Messages of ROS bags: MCAP (whole or cut off), ROS 2 SQLite bags, ROS 1 bags; no ROS needed.

Message types are decoded from the definitions in the bag.  MCAP is read from its beginning to the
first byte that makes no sense, index or not.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import apsw
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.highlevel.anyreader import AnyReaderError
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from insonify.errors import RecordingError, reason
from insonify.io.recordings.magic import MCAP_MAGIC, ROS1_MAGIC
from insonify.io.recordings.ros.definitions import Definitions
from insonify.io.recordings.ros.mcap_chunks import unpacked
from insonify.io.recordings.ros.messages import message_types
from insonify.io.recordings.ros.ros1_records import check_records

ROS1 = "ROS 1 bag"
_ENCODINGS = {"MSG": "ros2msg", "IDL": "ros2idl"}
"""Of rosbags' formats of definitions."""
DAMAGE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RecursionError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
    zstandard.ZstdError,
    RuntimeError,
    apsw.Error,
    AnyReaderError,
    McapError,
    Ros1Error,
    Ros2Error,
    SerdeError,
    TypesysError,
)
"""What the libraries beneath raise on bytes that make no sense."""


@dataclass(frozen=True, slots=True, eq=False)
class BagMessage:
    """A message not yet decoded; ``types`` has the definitions of its bag, if it is of one."""

    topic: str
    kind: str
    time_ns: int
    decode: Callable[[], Any]
    types: Typestore | None = None


@dataclass(slots=True, eq=False)
class Bag:
    """The messages of a bag.

    Attributes:
        path: The file, or the folder of a ROS 2 bag.
        format: What it is, for people.
        read: Reads all messages, or those of some topics, in the order of the file.
        cut: After reading: what ended it before its end, if anything did.
    """

    path: Path
    format: str
    read: Callable[[Collection[str] | None], Iterator[BagMessage]]
    cut: str = ""


def open_bag(path: Path, head: bytes) -> Bag:
    """The bag at a path, whose kind its first bytes tell; a folder is a ROS 2 bag."""
    if head.startswith(MCAP_MAGIC):
        bag = Bag(path, "MCAP (ROS 2)", lambda topics: _read_mcap(bag, topics))
    elif head.startswith(ROS1_MAGIC):
        bag = Bag(path, ROS1, lambda topics: _read_rosbags(bag, topics))
    else:
        bag = Bag(path, "ROS 2 bag", lambda topics: _read_rosbags(bag, topics))
    return bag


def _read_mcap(bag: Bag, topics: Collection[str] | None) -> Iterator[BagMessage]:
    channels: dict[int, tuple[str, str, Typestore]] = {}
    schemas: dict[int, Schema] = {}
    definitions = Definitions()
    with bag.path.open("rb") as file:
        size = bag.path.stat().st_size
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size)
        records = unpacked(reader)
        while True:
            try:
                record = next(records, None)
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.id not in channels:
                    channels[record.id] = _channel(record, schemas, definitions)
                if not isinstance(record, Message):
                    if record is None:
                        return
                    continue
                topic, kind, store = channels[record.channel_id]
            except DAMAGE as err:
                bag.cut = reason(err)
                return
            if topics is None or topic in topics:
                decode = _decoder(store, record.data, kind)
                yield BagMessage(topic, kind, record.log_time, decode, store)


def _channel(
    channel: Channel, schemas: dict[int, Schema], definitions: Definitions
) -> tuple[str, str, Typestore]:
    """Topic, type and types of a channel; a type that cannot be decoded is told when it is used."""
    schema = schemas[channel.schema_id]
    store = get_typestore(Stores.EMPTY)
    store.register(definitions.types(schema.data.decode(), schema.name, schema.encoding))
    return channel.topic, schema.name, store


def _decoder(store: Typestore, data: bytes, kind: str) -> Callable[[], Any]:
    return lambda: store.deserialize_cdr(data, kind)


def _read_rosbags(bag: Bag, topics: Collection[str] | None) -> Iterator[BagMessage]:
    try:
        if bag.path.is_file() and bag.format == ROS1:
            check_records(bag.path)
        _check_definitions(bag)
        with AnyReader([bag.path], default_typestore=message_types()) as reader:
            wanted = [c for c in reader.connections if topics is None or c.topic in topics]
            if not wanted:
                return
            messages = reader.messages(wanted)
            while True:
                try:
                    connection, time_ns, raw = next(messages)
                except StopIteration:
                    return
                except DAMAGE as err:
                    bag.cut = reason(err)
                    return
                kind = connection.msgtype
                decode = _reader_decoder(reader, raw, kind)
                yield BagMessage(connection.topic, kind, time_ns, decode, reader.typestore)
    except DAMAGE as err:
        raise RecordingError(
            f"{bag.path}: damaged, or not a whole {bag.format} ({reason(err)})"
        ) from err


def _check_definitions(bag: Bag) -> None:
    """Look at a bag's definitions before `AnyReader` reads them.

    Raises:
        ValueError: One asks for too much.
    """
    definitions = Definitions()
    with Ros1Reader(bag.path) if bag.format == ROS1 else Ros2Reader(bag.path) as plain:
        for connection in plain.connections:
            told = connection.msgdef
            definitions.types(told.data, connection.msgtype, _ENCODINGS.get(told.format.name, ""))


def _reader_decoder(reader: AnyReader, data: bytes, kind: str) -> Callable[[], Any]:
    return lambda: reader.deserialize(data, kind)
