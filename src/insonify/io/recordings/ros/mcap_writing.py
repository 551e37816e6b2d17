"""MCAP files of ROS 2 messages, written as they come.

Messages are gathered into chunks of about 1 MiB, each with its checksum; a chunk is in the file,
and the file with the operating system, as soon as it is full.  A recording whose writer was killed
lacks its index and its last chunk and is read up to there.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.writer import CompressionType, Writer

from insonify.io.recordings.ros.messages import message_types

_CHUNK_BYTES = 1 << 20
_RELIABLE, _VOLATILE, _LATCHED = 1, 2, 1


class McapWriter:
    """A recording being written."""

    def __init__(self, path: Path) -> None:
        """Begin a file; one of this name is replaced."""
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="insonify")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, topic: str, message: Any, time_ns: int) -> None:
        """Append a message; a topic is opened by its first one."""
        kind = message.__msgtype__
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic=topic,
                message_encoding="cdr",
                schema_id=self._schema(kind),
                metadata={"offered_qos_profiles": _quality(topic == "/tf_static")},
            )
        data = bytes(message_types().serialize_cdr(message, kind))
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)
        self._file.flush()

    @property
    def size_bytes(self) -> int:
        """What is in the file; a chunk that is not full is not."""
        return self._file.tell()

    def flush(self) -> None:
        """Write the chunk that is not full yet, and have the disk keep it all."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Write the last chunk and the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def _schema(self, kind: str) -> int:
        if kind not in self._schemas:
            text, _ = message_types().generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        return self._schemas[kind]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _quality(latched: bool) -> str:
    """ROS 2's quality of service, as rosbag2 writes it: reliable; latched or not."""
    forever = "  {}:\n    sec: 9223372036\n    nsec: 854775807\n"
    return (
        f"- history: 1\n  depth: {1 if latched else 10}\n  reliability: {_RELIABLE}\n"
        f"  durability: {_LATCHED if latched else _VOLATILE}\n"
        + forever.format("deadline")
        + forever.format("lifespan")
        + "  liveliness: 1\n"
        + forever.format("liveliness_lease_duration")
        + "  avoid_ros_namespace_conventions: false\n"
    )
