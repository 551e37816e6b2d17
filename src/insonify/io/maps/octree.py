"""Voxels as OctoMap's tree of 16 levels, level by level.

A node's code interleaves the bits of its key, x lowest, so that sorting codes puts children in
OctoMap's order and ``code >> 3`` is the parent.  OctoMap's key of a voxel is our index plus
32768 along each axis: both grids have a corner at the origin, so the centres agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.types import Array, Float32, Int32, Int64

DEPTH = 16
CENTRE_KEY = 1 << (DEPTH - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The nodes of one depth in order of their codes.

    Attributes:
        code: (N,) of each node.
        value: (N,) log-odds; of an inner node the largest of its children's, as in OctoMap.
        children: (N,) bit i is set if child i exists; 0 for a leaf.
        parent: (N,) row of each node's parent in the level above.
    """

    code: Int64
    value: Float32
    children: Array
    parent: Int64


def interleave(keys: Int64, bits: int = DEPTH) -> Int64:
    """Codes (N,) of keys (N, 3) below ``2**bits``; 21 bits fit."""
    code = np.zeros(len(keys), np.int64)
    for bit in range(bits):
        for axis in range(3):
            code |= ((keys[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def separate(code: Int64) -> Int64:
    """Keys (N, 3) of codes (N,)."""
    keys = np.zeros((len(code), 3), np.int64)
    for bit in range(DEPTH):
        for axis in range(3):
            keys[:, axis] |= ((code >> (3 * bit + axis)) & 1) << bit
    return keys


def pruned_tree(index: Int32 | Int64, value: Float32) -> list[Level]:
    """The tree of voxels, root first; eight equal leaves of one parent become one, as in OctoMap.

    Args:
        index: (N, 3) world indices of distinct voxels, each within +-32768.
        value: (N,) their log-odds.
    """
    code = interleave(index.astype(np.int64) + CENTRE_KEY)
    order = np.argsort(code)
    code, value = code[order], value[order]
    children = np.zeros(len(code), np.uint8)
    levels: list[tuple[Int64, Float32, Array]] = []
    for _ in range(DEPTH):
        above, start, parent = np.unique(code >> 3, return_index=True, return_inverse=True)
        if len(above) == 0:
            return []
        largest = np.maximum.reduceat(value, start)
        smallest = np.minimum.reduceat(value, start)
        leaf = children == 0
        present = np.add.reduceat((1 << (code & 7)).astype(np.int64), start).astype(np.uint8)
        alike = (present == 255) & (largest == smallest) & np.logical_and.reduceat(leaf, start)
        kept = ~alike[parent]
        levels.append((code[kept], value[kept], children[kept]))
        code, value = above, largest
        children = np.where(alike, 0, present).astype(np.uint8)
    tree = [Level(code, value, children, np.zeros(1, np.int64))]
    for code, value, children in reversed(levels):
        parent = np.searchsorted(tree[-1].code, code >> 3)
        tree.append(Level(code, value, children, parent))
    return tree


def places(levels: list[Level], leaf_bytes: int, inner_bytes: int) -> list[Int64]:
    """Where each node's own bytes begin, for each level (N,), parents before their children."""
    sizes = [np.where(level.children == 0, leaf_bytes, inner_bytes) for level in levels]
    for depth in range(len(levels) - 1, 0, -1):
        np.add.at(sizes[depth - 1], levels[depth].parent, sizes[depth])
    found = [np.zeros(1, np.int64)]
    for level, size in zip(levels[1:], sizes[1:], strict=True):
        before = np.cumsum(size) - size
        first = np.searchsorted(level.parent, level.parent, side="left")
        found.append(found[-1][level.parent] + inner_bytes + before - before[first])
    return found
