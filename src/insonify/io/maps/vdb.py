"""Maps as OpenVDB: the observed voxels as sparse grids ``log_odds`` and ``probability``.

A block of ours is a leaf of theirs (8 x 8 x 8, x outermost), so that a file is our blocks under
OpenVDB's tree of 32, 16 and 8.  Layout of file version 224 as OpenVDB's own ``io`` code reads it;
values are compressed by active mask and zlib.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from insonify.mapping.voxels import OBSERVED, VoxelMap, probability_from_log_odds
from insonify.types import Array, Bool, Float32, Int64

_MAGIC, _VERSION, _LIBRARY = 0x56444220, 224, (10, 0)
_ZIP_AND_MASK = 3
_NO_INACTIVE_VALUES = b"\0"
_UUID = b"00000000-0000-4000-8000-000000000000"
_TREE = "Tree_float_5_4_3"


def save_vdb(voxels: VoxelMap, path: Path) -> None:
    """Write the observed voxels; index (i, j, k) lies at the centre of our voxel (i, j, k)."""
    coords, active, log_odds = _observed(voxels)
    grids = (("log_odds", log_odds), ("probability", probability_from_log_odds(log_odds)))
    out = bytearray(struct.pack("<qIII?", _MAGIC, _VERSION, *_LIBRARY, True) + _UUID)
    out += _metadata({"creator": "insonify"}) + struct.pack("<I", len(grids))
    for name, values in grids:
        out += _string(name) + _string(_TREE) + _string("")
        start = len(out) + 24
        about = _metadata({"class": "unknown", "name": name, "value_type": "float"})
        head = (
            struct.pack("<I", _ZIP_AND_MASK) + about + _transform(voxels.voxel_m, voxels.origin_m)
        )
        topology, leaves = _tree(coords.astype(np.int64), active, values)
        ends = start + len(head) + len(topology)
        out += struct.pack("<qqq", start, ends, ends + len(leaves)) + head + topology + leaves
    path.write_bytes(bytes(out))


def _observed(voxels: VoxelMap) -> tuple[Array, Bool, Float32]:
    """Blocks with observed voxels (N, 3), which of these are (N, 512), and their log-odds."""
    found = []
    for part in voxels.parts():
        observed = (part.seen & OBSERVED) > 0
        kept = observed.any(axis=1)
        found.append((part.coords[kept], observed[kept], part.log_odds[kept]))
    coords, active, log_odds = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return coords, active, log_odds


def _tree(coords: Int64, active: Bool, values: Float32) -> tuple[bytes, bytes]:
    """A tree's nodes from the root down, and its leaves' values in the same order."""
    topology = bytearray(struct.pack("<If", 1, 0.0))
    leaves = bytearray()
    masks = np.packbits(active, axis=1, bitorder="little")
    roots = list(_grouped(coords, np.arange(len(coords)), 9))
    topology += struct.pack("<II", 0, len(roots))
    for root, large in roots:
        topology += struct.pack("<iii", *(root << 12).tolist())
        middles = list(_grouped(coords, large, 4))
        middles.sort(key=lambda group: _offset(group[0], 5))
        topology += _inner_node(np.array([_offset(node, 5) for node, _ in middles]), 5)
        for _, small in middles:
            offset = np.array([_offset(coords[row], 4) for row in small])
            small, offset = small[np.argsort(offset)], np.sort(offset)
            topology += _inner_node(offset, 4)
            for row in small:
                mask = masks[row].tobytes()
                topology += mask
                leaves += mask + _values(values[row, active[row]])
    return bytes(topology), bytes(leaves)


def _grouped(coords: Int64, rows: Array, shift: int) -> Iterator[tuple[Int64, Array]]:
    """Rows of blocks under the same node, with the node's index."""
    if not len(rows):
        return
    nodes, which = np.unique(coords[rows] >> shift, axis=0, return_inverse=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    splits = np.flatnonzero(np.diff(which.reshape(-1)[order])) + 1
    yield from zip(nodes, np.split(rows[order], splits), strict=True)


def _offset(index: Int64, log2: int) -> int:
    """Where a child of a node of ``2**log2`` children along each axis stands in it."""
    x, y, z = (int(i) & ((1 << log2) - 1) for i in index)
    return (x << 2 * log2) | (y << log2) | z


def _inner_node(children: Array, log2: int) -> bytes:
    """Child mask, value mask, and no values."""
    bits = np.zeros(1 << 3 * log2, bool)
    bits[children] = True
    empty = bytes(len(bits) // 8)
    return np.packbits(bits, bitorder="little").tobytes() + empty + _values(np.empty(0, np.float32))


def _values(active: Float32) -> bytes:
    raw = active.astype("<f4").tobytes()
    packed = zlib.compress(raw) if raw else b""
    if not raw or len(packed) >= len(raw):
        return _NO_INACTIVE_VALUES + struct.pack("<q", -len(raw)) + raw
    return _NO_INACTIVE_VALUES + struct.pack("<q", len(packed)) + packed


def _transform(voxel_m: float, origin_m: tuple[float, float, float]) -> bytes:
    """World from index: scale, then half a voxel's shift to the centre, and the map's origin."""
    rows = (voxel_m, voxel_m, 1 / voxel_m, voxel_m**-2, 0.5 / voxel_m)
    centre = voxel_m / 2 + np.array(origin_m)
    numbers = (*centre, *np.repeat(rows, 3))
    return _string("UniformScaleTranslateMap") + struct.pack("<18d", *numbers)


def _metadata(texts: dict[str, str]) -> bytes:
    items = (_string(key) + _string("string") + _string(text) for key, text in texts.items())
    return struct.pack("<I", len(texts)) + b"".join(items)


def _string(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode("ascii")
