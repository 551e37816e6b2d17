"""The outline of a ROS 1 bag: that its records follow each other to the end of the file.

rosbags trusts the lengths in a bag.  A damaged one would have it ask for gigabytes, so the lengths
and the places that point at records are looked through first.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_BAG_HEADER, _CHUNK_INFO, _CHUNK = 0x03, 0x06, 0x05
_LARGEST_GROWTH = 300
"""Of LZ4 and bzip2 data, unpacked; LZ4 cannot reach it."""


def check_records(path: Path) -> None:
    """Look through the records of a bag of format 2.0.

    Raises:
        ValueError: A record does not fit into the file, or a place points at none.
    """
    size = path.stat().st_size
    starts: set[int] = set()
    places: list[int] = []
    with path.open("rb") as file:
        file.readline(64)
        while (at := file.tell()) < size:
            starts.add(at)
            header = _sized(file, size)
            fields = dict(_fields(header))
            kind = fields.get(b"op", b"\0")[0]
            length = _length(file, size)
            if kind == _BAG_HEADER:
                places += _numbers(fields, b"index_pos", "<Q")
            elif kind == _CHUNK_INFO:
                places += _numbers(fields, b"chunk_pos", "<Q")
            elif kind == _CHUNK:
                (unpacked,) = _numbers(fields, b"size", "<I")
                if unpacked > _LARGEST_GROWTH * length + 65536:
                    raise ValueError(f"the chunk at byte {at} says it unpacks to {unpacked} bytes")
            file.seek(length, 1)
    starts.add(size)
    for place in places:
        if place not in starts:
            raise ValueError(f"there is no record at byte {place}, where one should be")


def _length(file: BinaryIO, size: int) -> int:
    at = file.tell()
    raw = file.read(4)
    length = int.from_bytes(raw, "little")
    if len(raw) < 4 or at + 4 + length > size:
        raise ValueError(f"the record at byte {at} reaches beyond the end of the file")
    return length


def _sized(file: BinaryIO, size: int) -> bytes:
    return file.read(_length(file, size))


def _fields(header: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 4 <= len(header):
        length = int.from_bytes(header[at : at + 4], "little")
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        if equals:
            yield name, value or b"\0"
        at += 4 + length


def _numbers(fields: dict[bytes, bytes], name: bytes, kind: str) -> list[int]:
    value = fields.get(name, b"")
    if len(value) != struct.calcsize(kind):
        raise ValueError(f"a record has no {name.decode()}")
    return [struct.unpack(kind, value)[0]]
