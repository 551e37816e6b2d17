"""Chunks of an MCAP: unpacked to what they say they hold, and no further."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import zstandard
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk

from insonify import memory
from insonify.limits import CHUNK_GROWTH, LEAST_CHUNK_BYTES, MOST_CHUNK_BYTES


def unpacked(reader: StreamReader) -> Iterator[Any]:
    """Records in order, chunks taken apart.

    Raises:
        ValueError: A chunk is larger than `insonify.limits` allows, than fits, or than it says.
    """
    for record in reader.records:
        if isinstance(record, Chunk):
            yield from breakup_chunk(_plain(record), validate_crc=True)
        else:
            yield record


def _plain(chunk: Chunk) -> Chunk:
    """A chunk whose data are not compressed, unless in a way that is not known."""
    size = chunk.uncompressed_size
    most = min(MOST_CHUNK_BYTES, max(LEAST_CHUNK_BYTES, CHUNK_GROWTH * len(chunk.data)))
    if size > most or not memory.fits(2 * size):
        raise ValueError(f"a chunk of {len(chunk.data)} bytes says that it unpacks to {size}")
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        return chunk
    if len(data) != size:
        raise ValueError(f"a chunk that should unpack to {size} bytes does not")
    return replace(chunk, compression="", data=bytes(data))
