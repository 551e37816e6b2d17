"""DBSCAN on voxels: the clusters of uncertainty (Park et al. 2025, section 2.3).

The true meaning of DBSCAN (Ester et al. 1996), the labels of scikit-learn, none of its memory.
Voxels are sorted by a linear key and packed into words of 64 along z, one bit a voxel.  A
neighbourhood is then a handful of bit windows, one for each neighbouring column, and its words
are found by moving a pointer along with the sorted words.  Memory is a few numbers a voxel,
whatever the neighbourhood's size.
"""

from __future__ import annotations

import math

import numpy as np

from insonify.jit import kernel, parallel_kernel, prange
from insonify.types import Array, Int32, Int64

NOISE = -1
_CHUNKS = 64
_CONNECT_CHUNKS = 8
_WORD = 64


def dbscan(voxels: Int64 | Int32, eps: float, min_samples: int) -> Int64:
    """Cluster labels of distinct voxels, as scikit-learn's DBSCAN would give them.

    Args:
        voxels: (N, 3) integer indices, no two alike, in any order.
        eps: Radius in voxels, below 64; a voxel at exactly this distance is a neighbour.
        min_samples: Neighbours, itself among them, that make a voxel a core voxel.

    Returns:
        (N,) labels from 0, in the order in which clusters first appear; -1 is noise.

    Raises:
        ValueError: Two voxels are the same, or the arguments are out of range.
    """
    if not 0.0 < eps < _WORD or min_samples < 1:
        raise ValueError(
            f"eps ({eps:g} voxels) must lie between 0 and {_WORD}, "
            f"and min_samples ({min_samples}) be at least 1"
        )
    if len(voxels) == 0:
        return np.empty(0, np.int64)
    reach = math.floor(eps + 1e-9)
    keys, strides = _linear_keys(voxels, reach)
    keys, order = _sort(keys)
    if (keys[1:] == keys[:-1]).any():
        raise ValueError("voxels must be distinct")
    runs = _stencil(eps, reach, strides)
    ids, bits, start = _pack(keys)
    core = _count_neighbours(keys, ids, bits, start, runs, _CHUNKS) >= min_samples
    core_bits = _pack_core(keys, core, start)
    cuts = _column_cuts(ids, strides[1] // _WORD)
    root = _connect(keys, ids, bits, core_bits, start, runs, reach, cuts)
    number = _number_clusters(root, core, order)
    return _spread(keys, ids, bits, core_bits, start, runs, reach, number, order, _CHUNKS)


def _linear_keys(voxels: Int64 | Int32, reach: int) -> tuple[Int64, tuple[int, int]]:
    """One integer a voxel, spaced so that no neighbourhood wraps around a column's end."""
    low = [int(voxels[:, axis].min()) for axis in range(3)]
    high = [int(voxels[:, axis].max()) for axis in range(3)]
    span = [b - a + 1 + reach for a, b in zip(low, high, strict=True)]
    stride_y = -(-span[2] // _WORD) * _WORD
    stride_x = span[1] * stride_y
    if span[0] * stride_x >= 2**62:
        raise ValueError(f"voxels span {span}, too far for 64-bit keys")
    return _keys(voxels, np.array(low), stride_x, stride_y), (stride_x, stride_y)


@kernel
def _keys(voxels: Int64 | Int32, low: Int64, stride_x: int, stride_y: int) -> Int64:
    keys = np.empty(len(voxels), np.int64)
    for i in range(len(voxels)):
        x, y, z = voxels[i, 0] - low[0], voxels[i, 1] - low[1], voxels[i, 2] - low[2]
        keys[i] = x * stride_x + y * stride_y + z
    return keys


@kernel
def _sort(keys: Int64) -> tuple[Int64, Int64]:
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


def _stencil(eps: float, reach: int, strides: tuple[int, int]) -> Int64:
    """The neighbourhood as columns: (columns, 2) offset in words, half length, in key order."""
    runs = []
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            left = eps * eps + 1e-9 - dx * dx - dy * dy
            if left >= 0.0:
                offset = (dx * strides[0] + dy * strides[1]) // _WORD
                runs.append((offset, math.isqrt(math.floor(left))))
    return np.array(runs, np.int64)


@kernel
def _pack(keys: Int64) -> tuple[Int64, Array, Int32]:
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
def _pack_core(keys: Int64, core: Array, start: Int32) -> Array:
    """The bits of the core voxels alone, word by word."""
    bits = np.zeros(len(start) - 1, np.uint64)
    for word in range(len(bits)):
        for i in range(start[word], start[word + 1]):
            bits[word] |= np.uint64(core[i]) << np.uint64(keys[i] & 63)
    return bits


@kernel
def _popcount(bits: np.uint64) -> np.int64:
    """Number of set bits of a uint64; LLVM makes one instruction of this."""
    x = np.uint64(bits)
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    two = np.uint64(0x3333333333333333)
    x = (x & two) + ((x >> np.uint64(2)) & two)
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def _span(first: int, last: int) -> np.uint64:
    """Bits ``first`` to ``last`` of a word, both cut to the word; 0 if none is in it."""
    if first > 63 or last < 0 or last < first:
        return np.uint64(0)
    everything = np.uint64(0xFFFFFFFFFFFFFFFF)
    up = everything << np.uint64(max(first, 0))
    return up & (everything >> np.uint64(63 - min(last, 63)))


@kernel
def _advance(ids: Int64, word: int, target: int) -> int:
    """The first word from ``word`` on whose id is at least ``target``."""
    while word < len(ids) and ids[word] < target:
        word += 1
    return word


@parallel_kernel
def _count_neighbours(
    keys: Int64, ids: Int64, bits: Array, start: Int32, runs: Int64, chunks: int
) -> Int32:
    """How many voxels lie in each voxel's neighbourhood, itself included."""
    counts = np.zeros(len(keys), np.int32)
    words = len(ids)
    for chunk in prange(chunks):
        begin, end = words * chunk // chunks, words * (chunk + 1) // chunks
        for run in range(len(runs)):
            half = runs[run, 1]
            near = np.searchsorted(ids, ids[begin] + runs[run, 0] - 1) if begin < end else 0
            for word in range(begin, end):
                target = ids[word] + runs[run, 0]
                near = _advance(ids, near, target - 1)
                below = np.uint64(0)
                middle = np.uint64(0)
                above = np.uint64(0)
                for other in range(near, min(near + 3, words)):
                    if ids[other] == target - 1:
                        below = bits[other]
                    elif ids[other] == target:
                        middle = bits[other]
                    elif ids[other] == target + 1:
                        above = bits[other]
                if (below | middle | above) == 0:
                    continue
                for i in range(start[word], start[word + 1]):
                    bit = keys[i] & 63
                    inside = _popcount(middle & _span(bit - half, bit + half))
                    if bit < half:
                        inside += _popcount(below & _span(64 + bit - half, 63))
                    if bit + half > 63:
                        inside += _popcount(above & _span(0, bit + half - 64))
                    counts[i] += inside
    return counts


@kernel
def _root(parent: Int32, i: int) -> int:
    """Representative of a set, halving the way there."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _core_neighbours(
    found: Int32,
    bit: int,
    half: int,
    reach: int,
    near: int,
    target: int,
    ids: Int64,
    bits: Array,
    core_bits: Array,
    start: Int32,
) -> int:
    """Write one core neighbour for each connected stretch of a column; return how many.

    Two core voxels of a column no more than ``reach`` apart are neighbours themselves, so that
    one of them speaks for both.
    """
    count = 0
    last = -1000
    for other in range(near, min(near + 3, len(ids))):
        shift = (ids[other] - target) * 64
        if shift < -64 or shift > 64:
            continue
        window = core_bits[other] & _span(bit - half - shift, bit + half - shift)
        while window != 0:
            lowest = window & (~window + np.uint64(1))
            place = _popcount(lowest - np.uint64(1))
            if place + shift - last > reach:
                found[count] = start[other] + _popcount(bits[other] & (lowest - np.uint64(1)))
                count += 1
            last = place + shift
            window ^= lowest
    return count


def _column_cuts(ids: Int64, words_per_column: int) -> Int64:
    """Where to cut the words into chunks, so that no column, and so no stretch of it, is cut."""
    even = ids[np.arange(_CONNECT_CHUNKS) * len(ids) // _CONNECT_CHUNKS]
    cuts = np.searchsorted(ids, even // words_per_column * words_per_column)
    return np.append(cuts, len(ids))


@parallel_kernel
def _connect(
    keys: Int64,
    ids: Int64,
    bits: Array,
    core_bits: Array,
    start: Int32,
    runs: Int64,
    reach: int,
    cuts: Int64,
) -> Int32:
    """Each voxel's set of connected core voxels, named by its first in key order.

    Chunks of words are connected in parallel, each within itself; then, one after another, the
    words near a chunk's end with what lies beyond.  The stencil is symmetric: half is enough.
    """
    parent = np.arange(len(keys)).astype(np.int32)
    chunks = len(cuts) - 1
    for chunk in prange(chunks):
        begin, end = cuts[chunk], cuts[chunk + 1]
        for run in range(len(runs) // 2, len(runs)):
            _connect_words(
                parent, begin, end, start[begin], start[end], runs[run, 0], runs[run, 1],
                reach, keys, ids, bits, core_bits, start,
            )  # fmt: skip
    for chunk in range(chunks):
        begin, end = cuts[chunk], cuts[chunk + 1]
        if begin == end or end == len(ids):
            continue
        for run in range(len(runs) // 2, len(runs)):
            crossing = max(begin, np.searchsorted(ids, ids[end] - runs[run, 0] - 1))
            _connect_words(
                parent, crossing, end, start[end], len(keys), runs[run, 0], runs[run, 1],
                reach, keys, ids, bits, core_bits, start,
            )  # fmt: skip
    for i in range(len(parent)):
        parent[i] = parent[parent[i]]  # a parent comes before its children, so this is the root
    return parent


@kernel
def _connect_words(
    parent: Int32,
    begin: int,
    end: int,
    low: int,
    high: int,
    offset: int,
    half: int,
    reach: int,
    keys: Int64,
    ids: Int64,
    bits: Array,
    core_bits: Array,
    start: Int32,
) -> None:
    """Union of the core voxels of some words with their neighbours in one column of the stencil.

    Only neighbours from voxel ``low`` to before voxel ``high`` count.
    """
    found = np.empty(2 * _WORD, np.int32)
    near = np.searchsorted(ids, ids[begin] + offset - 1) if begin < end else 0
    for word in range(begin, end):
        target = ids[word] + offset
        near = _advance(ids, near, target - 1)
        if near == len(ids) or start[near] >= high:
            break
        if core_bits[word] == 0 or ids[near] > target + 1:
            continue
        for i in range(start[word], start[word + 1]):
            bit = keys[i] & 63
            if (core_bits[word] >> np.uint64(bit)) & np.uint64(1) == 0:
                continue
            count = _core_neighbours(
                found, bit, half, reach, near, target, ids, bits, core_bits, start
            )
            for k in range(count):
                if low <= found[k] < high and parent[i] != parent[found[k]]:
                    a, b = _root(parent, i), _root(parent, found[k])
                    if a < b:
                        parent[b] = a
                    elif b < a:
                        parent[a] = b


def _number_clusters(root: Int32, core: Array, order: Int64) -> Int32:
    """Number of each voxel's set: clusters count from 0 by their first core voxel in the input."""
    firsts = _first_in_input(root, core, order)
    found = np.flatnonzero(firsts < len(root))
    number = np.full(len(root), NOISE, np.int32)
    number[found[np.argsort(firsts[found])]] = np.arange(len(found), dtype=np.int32)
    return number[root]


@kernel
def _first_in_input(root: Int32, core: Array, order: Int64) -> Int64:
    """Smallest input position of a core voxel in each set; the number of voxels if it has none."""
    n = len(root)
    firsts = np.full(n, n, np.int64)
    for i in range(n):
        if core[i]:
            firsts[root[i]] = min(firsts[root[i]], order[i])
    return firsts


@parallel_kernel
def _spread(
    keys: Int64,
    ids: Int64,
    bits: Array,
    core_bits: Array,
    start: Int32,
    runs: Int64,
    reach: int,
    number: Int32,
    order: Int64,
    chunks: int,
) -> Int64:
    """Labels in input order; a border voxel takes the lowest number among its core neighbours.

    That is the cluster that a sequential DBSCAN would have reached it from first.
    """
    labels = np.empty(len(keys), np.int64)
    words = len(ids)
    for chunk in prange(chunks):
        begin, end = words * chunk // chunks, words * (chunk + 1) // chunks
        found = np.empty(2 * _WORD, np.int32)
        nearest = number[start[begin] : start[end]].copy()
        for run in range(len(runs)):
            half = runs[run, 1]
            near = np.searchsorted(ids, ids[begin] + runs[run, 0] - 1) if begin < end else 0
            for word in range(begin, end):
                target = ids[word] + runs[run, 0]
                near = _advance(ids, near, target - 1)
                border = bits[word] & ~core_bits[word]
                if near == words or ids[near] > target + 1 or border == 0:
                    continue
                for i in range(start[word], start[word + 1]):
                    bit = keys[i] & 63
                    if (border >> np.uint64(bit)) & np.uint64(1) == 0:
                        continue
                    count = _core_neighbours(
                        found, bit, half, reach, near, target, ids, bits, core_bits, start
                    )
                    own = nearest[i - start[begin]]
                    for k in range(count):
                        other = number[found[k]]
                        own = other if own < 0 else min(own, other)
                    nearest[i - start[begin]] = own
        for i in range(start[begin], start[end]):
            labels[order[i]] = nearest[i - start[begin]]
    return labels
