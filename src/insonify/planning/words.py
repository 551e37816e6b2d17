"""Voxels as words of bits, 64 along z in one: sorted, packed, counted, cut."""

from __future__ import annotations

import numpy as np

from insonify.jit import kernel
from insonify.types import Array, Int32, Int64

WORD = 64
"""Voxels in a word."""


def linear_keys(voxels: Int64 | Int32, reach: int) -> tuple[Int64, tuple[int, int]]:
    """One integer a voxel, spaced so that no neighbourhood wraps around a column's end."""
    low = [int(voxels[:, axis].min()) for axis in range(3)]
    high = [int(voxels[:, axis].max()) for axis in range(3)]
    spans = [b - a + 1 + reach for a, b in zip(low, high, strict=True)]
    stride_y = -(-spans[2] // WORD) * WORD
    stride_x = spans[1] * stride_y
    if spans[0] * stride_x >= 2**62:
        raise ValueError(f"voxels span {spans}, too far for 64-bit keys")
    return _keys(voxels, np.array(low), stride_x, stride_y), (stride_x, stride_y)


@kernel
def _keys(voxels: Int64 | Int32, low: Int64, stride_x: int, stride_y: int) -> Int64:
    keys = np.empty(len(voxels), np.int64)
    for i in range(len(voxels)):
        x, y, z = voxels[i, 0] - low[0], voxels[i, 1] - low[1], voxels[i, 2] - low[2]
        keys[i] = x * stride_x + y * stride_y + z
    return keys


@kernel
def sort_keys(keys: Int64) -> tuple[Int64, Int64]:
    """Sorted keys and their positions in the input: a radix sort, 11 bits a pass."""
    n = len(keys)
    order = np.arange(n)
    largest = keys.max()
    shift = 0
    while shift == 0 or (largest >> shift) > 0:
        places = np.zeros(2049, np.int64)
        for i in range(n):
            places[((keys[i] >> shift) & 2047) + 1] += 1
        places = np.cumsum(places)
        next_keys = np.empty_like(keys)
        next_order = np.empty_like(order)
        for i in range(n):
            digit = (keys[i] >> shift) & 2047
            next_keys[places[digit]] = keys[i]
            next_order[places[digit]] = order[i]
            places[digit] += 1
        keys, order = next_keys, next_order
        shift += 11
    return keys, order


@kernel
def pack(keys: Int64) -> tuple[Int64, Array, Int32]:
    """Sorted keys as words: their ids (W,), their bits (W,), and where each starts (W + 1,)."""
    n = len(keys)
    words = 1
    for i in range(1, n):
        words += (keys[i] >> 6) != (keys[i - 1] >> 6)
    ids = np.empty(words, np.int64)
    bits = np.zeros(words, np.uint64)
    start = np.empty(words + 1, np.int32)
    word = -1
    for i in range(n):
        if i == 0 or (keys[i] >> 6) != (keys[i - 1] >> 6):
            word += 1
            ids[word] = keys[i] >> 6
            start[word] = i
        bits[word] |= np.uint64(1) << np.uint64(keys[i] & 63)
    start[words] = n
    return ids, bits, start


@kernel
def pack_core(keys: Int64, core: Array, start: Int32) -> Array:
    """The bits of the core voxels alone, word by word."""
    bits = np.zeros(len(start) - 1, np.uint64)
    for word in range(len(bits)):
        for i in range(start[word], start[word + 1]):
            bits[word] |= np.uint64(core[i]) << np.uint64(keys[i] & 63)
    return bits


@kernel
def popcount(bits: np.uint64) -> np.int64:
    """Number of set bits of a uint64; LLVM makes one instruction of this."""
    x = np.uint64(bits)
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    two = np.uint64(0x3333333333333333)
    x = (x & two) + ((x >> np.uint64(2)) & two)
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def span(first: int, last: int) -> np.uint64:
    """Bits ``first`` to ``last`` of a word, both cut to the word; 0 if none is in it."""
    if first > 63 or last < 0 or last < first:
        return np.uint64(0)
    everything = np.uint64(0xFFFFFFFFFFFFFFFF)
    up = everything << np.uint64(max(first, 0))
    return up & (everything >> np.uint64(63 - min(last, 63)))


@kernel
def advance(ids: Int64, word: int, target: int) -> int:
    """The first word from ``word`` on whose id is at least ``target``."""
    while word < len(ids) and ids[word] < target:
        word += 1
    return word
