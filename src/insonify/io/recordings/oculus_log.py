"""Logs of Blueprint's Oculus Viewer and ViewPoint (``.oculus``): items, each with its time.

A header of 48 bytes, then items: a header of 40 bytes and a payload, which for a sonar is one whole
network message as in a ``.raw`` file.  Layout as `oculus-python` and ENSTA's driver read it; the
sizes in the headers are believed, since they differ from one build to another.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from insonify.errors import RecordingError

START = struct.pack("<I", 0x11223344)
_HEAD = struct.Struct("<II16sHH4xqd")
_ITEM = struct.Struct("<IIHH4xdH2xII")
_ITEM_START = struct.pack("<I", 0xAABBCCDD)
_SONAR, _PACKED = 10, 1
MOST_BYTES = 64 << 20
"""An item, or what it unpacks to, larger than this is damage."""


@dataclass(frozen=True, slots=True)
class Item:
    """A sonar's message in a log.

    Attributes:
        at: Where it begins in the file.
        size: Its bytes there.
        time_s: When it was logged, in seconds since 1970.
        packed: Whether it is compressed.
    """

    at: int
    size: int
    time_s: float
    packed: bool

    def read(self, file: BinaryIO, most: int = MOST_BYTES) -> bytes:
        """The message, or its first bytes; nothing if it cannot be unpacked."""
        file.seek(self.at)
        if not self.packed:
            return file.read(min(self.size, most))
        raw = file.read(self.size)
        try:
            return zlib.decompressobj().decompress(raw[4:], most)
        except zlib.error:
            return b""


def sonar_items(path: Path, lost: list[int]) -> Iterator[Item]:
    """The sonar's messages of a log; where bytes had to be skipped is noted in ``lost``.

    Raises:
        RecordingError: The log is encrypted, or its header is cut off.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise RecordingError(f"{path}: cut off in its header")
        _, at, _, _, encryption, _, _ = _HEAD.unpack(head)
        if encryption:
            raise RecordingError(f"{path}: an encrypted log; save it again without encryption")
        while at + _ITEM.size <= size:
            file.seek(at)
            start, header, kind, _, time_s, packing, _, length = _ITEM.unpack(file.read(_ITEM.size))
            sane = start == 0xAABBCCDD and _ITEM.size <= header <= 4096 and length <= MOST_BYTES
            if not sane or at + header + length > size:
                lost.append(at)
                at = next_start(file, at + 1, size, _ITEM_START)
                continue
            if kind == _SONAR and packing in (0, _PACKED):
                yield Item(at + header, length, time_s, packing == _PACKED)
            at += header + length


def next_start(file: BinaryIO, at: int, size: int, start: bytes) -> int:
    """Where bytes next stand in a file, from ``at`` on; the file's size if they do not."""
    file.seek(at)
    while at < size:
        raw = file.read(1 << 20)
        found = raw.find(start)
        if found >= 0:
            return at + found
        at += max(1, len(raw) - len(start) + 1)
        file.seek(at)
    return size
