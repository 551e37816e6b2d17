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
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.highlevel import AnyReader
from rosbags.highlevel.anyreader import AnyReaderError
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from insonify.errors import RecordingError, reason
from insonify.io.recordings.magic import MCAP_MAGIC, ROS1_MAGIC
from insonify.io.recordings.ros.messages import message_types
from insonify.io.recordings.ros.ros1_records import check_records

ROS1 = "ROS 1 bag"
MOST_CHUNK_BYTES = 1 << 30
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
    """A message not yet decoded."""

    topic: str
    kind: str
    time_ns: int
    decode: Callable[[], Any]


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
    with bag.path.open("rb") as file:
        size = bag.path.stat().st_size
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size)
        records = _unpacked(reader)
        while True:
            try:
                record = next(records, None)
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.id not in channels:
                    channels[record.id] = _channel(record, schemas)
                if not isinstance(record, Message):
                    if record is None:
                        return
                    continue
                topic, kind, store = channels[record.channel_id]
            except DAMAGE as err:
                bag.cut = reason(err)
                return
            if topics is None or topic in topics:
                yield BagMessage(topic, kind, record.log_time, _decoder(store, record.data, kind))


def _unpacked(reader: StreamReader) -> Iterator[Any]:
    """Records in order, chunks taken apart."""
    for record in reader.records:
        if not isinstance(record, Chunk):
            yield record
        elif record.uncompressed_size > MOST_CHUNK_BYTES:
            raise ValueError(f"a chunk says that it unpacks to {record.uncompressed_size} bytes")
        else:
            yield from breakup_chunk(record, validate_crc=True)


def _channel(channel: Channel, schemas: dict[int, Schema]) -> tuple[str, str, Typestore]:
    """Topic, type and types of a channel; a type that cannot be decoded is told when it is used."""
    schema = schemas[channel.schema_id]
    text = schema.data.decode()
    store = get_typestore(Stores.EMPTY)
    if schema.encoding == "ros2msg":
        store.register(get_types_from_msg(text, schema.name))
    elif schema.encoding in {"ros2idl", "omgidl"}:
        store.register(_from_idl(text))
    return channel.topic, schema.name, store


def _from_idl(text: str) -> Any:
    rule = "=" * 80 + "\n"
    types: Any = {}
    parts = text.split(rule)[1:] if text.startswith(f"{rule}IDL: ") else [text]
    for part in parts:
        types |= get_types_from_idl(part.split("\n", 1)[1] if part is not text else part)
    return types


def _decoder(store: Typestore, data: bytes, kind: str) -> Callable[[], Any]:
    return lambda: store.deserialize_cdr(data, kind)


def _read_rosbags(bag: Bag, topics: Collection[str] | None) -> Iterator[BagMessage]:
    try:
        if bag.path.is_file() and bag.format == ROS1:
            check_records(bag.path)
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
                yield BagMessage(
                    connection.topic, kind, time_ns, _reader_decoder(reader, raw, kind)
                )
    except DAMAGE as err:
        raise RecordingError(
            f"{bag.path}: damaged, or not a whole {bag.format} ({reason(err)})"
        ) from err


def _reader_decoder(reader: AnyReader, data: bytes, kind: str) -> Callable[[], Any]:
    return lambda: reader.deserialize(data, kind)
