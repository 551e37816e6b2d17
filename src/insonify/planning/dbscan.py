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
from insonify.planning.words import (
    WORD,
    advance,
    linear_keys,
    pack,
    pack_core,
    popcount,
    sort_keys,
    span,
)
from insonify.types import Array, Int32, Int64

NOISE = -1
_CHUNKS = 64
_CONNECT_CHUNKS = 8


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
    if not 0.0 < eps < WORD or min_samples < 1:
        raise ValueError(
            f"eps ({eps:g} voxels) must lie between 0 and {WORD}, "
            f"and min_samples ({min_samples}) be at least 1"
        )
    if len(voxels) == 0:
        return np.empty(0, np.int64)
    reach = math.floor(eps + 1e-9)
    keys, strides = linear_keys(voxels, reach)
    keys, order = sort_keys(keys)
    if (keys[1:] == keys[:-1]).any():
        raise ValueError("voxels must be distinct")
    runs = _stencil(eps, reach, strides)
    ids, bits, start = pack(keys)
    core = _count_neighbours(keys, ids, bits, start, runs, _CHUNKS) >= min_samples
    core_bits = pack_core(keys, core, start)
    cuts = _column_cuts(ids, strides[1] // WORD)
    root = _connect(keys, ids, bits, core_bits, start, runs, reach, cuts)
    number = _number_clusters(root, core, order)
    return _spread(keys, ids, bits, core_bits, start, runs, reach, number, order, _CHUNKS)


def _stencil(eps: float, reach: int, strides: tuple[int, int]) -> Int64:
    """The neighbourhood as columns: (columns, 2) offset in words, half length, in key order."""
    runs = []
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            left = eps * eps + 1e-9 - dx * dx - dy * dy
            if left >= 0.0:
                offset = (dx * strides[0] + dy * strides[1]) // WORD
                runs.append((offset, math.isqrt(math.floor(left))))
    return np.array(runs, np.int64)


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
                near = advance(ids, near, target - 1)
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
                    inside = popcount(middle & span(bit - half, bit + half))
                    if bit < half:
                        inside += popcount(below & span(64 + bit - half, 63))
                    if bit + half > 63:
                        inside += popcount(above & span(0, bit + half - 64))
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
        window = core_bits[other] & span(bit - half - shift, bit + half - shift)
        while window != 0:
            lowest = window & (~window + np.uint64(1))
            place = popcount(lowest - np.uint64(1))
            if place + shift - last > reach:
                found[count] = start[other] + popcount(bits[other] & (lowest - np.uint64(1)))
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
    found = np.empty(2 * WORD, np.int32)
    near = np.searchsorted(ids, ids[begin] + offset - 1) if begin < end else 0
    for word in range(begin, end):
        target = ids[word] + offset
        near = advance(ids, near, target - 1)
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
        found = np.empty(2 * WORD, np.int32)
        nearest = number[start[begin] : start[end]].copy()
        for run in range(len(runs)):
            half = runs[run, 1]
            near = np.searchsorted(ids, ids[begin] + runs[run, 0] - 1) if begin < end else 0
            for word in range(begin, end):
                target = ids[word] + runs[run, 0]
                near = advance(ids, near, target - 1)
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
