"""OctoMap's files: ``.bt`` (occupied or free) and ``.ot`` (log-odds).

Hornung et al. 2013, doi:10.1007/s10514-012-9321-0.  A header of text lines ends in ``data``; then
come the nodes, parents first.  In ``.ot`` each has its log-odds (float32) and a byte of which
children exist; in ``.bt`` each inner node has two bits a child: absent, free, occupied or inner.

A voxel that no echo or silence has spoken about is left out, which is OctoMap's "unknown".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.errors import MapFileError, OutputError, reading
from insonify.io.maps.blocks import MOST_LOG_ODDS, check_memory, check_voxel
from insonify.io.maps.octree import CENTRE_KEY, DEPTH, Level, places, pruned_tree, separate
from insonify.io.maps.sidecar import load_origin, save_origin
from insonify.jit import kernel
from insonify.limits import BLOCKS_PER_BYTE, LEAST_BLOCKS
from insonify.mapping.voxels import BLOCK, IN_VIEW, OBSERVED, VOXELS_PER_BLOCK, VoxelMap
from insonify.types import Array, Float32, Int64

FREE_LOG_ODDS, OCCUPIED_LOG_ODDS = np.float32(-2.0), np.float32(3.5)
"""OctoMap's default clamps, p = 0.12 and 0.97: what its own reader makes of a ``.bt``."""

_LEAST = np.float32(1e-37)
_TITLE = {".bt": b"# Octomap OcTree binary file", ".ot": b"# Octomap OcTree file"}
_LONGEST_HEADER = 4096
_BLOCK_DEPTH = DEPTH - 3
_WHOLE, _SHORT, _DEEP, _MANY = range(4)


def save_octomap(voxels: VoxelMap, path: Path) -> None:
    """Write the observed voxels as OctoMap's ``.bt`` or ``.ot``, by the file's suffix.

    Raises:
        OutputError: The map reaches farther than OctoMap's 32768 voxels from the origin.
    """
    observed = voxels.select(lambda part: (part.seen & OBSERVED) > 0)
    index, value = observed.index, observed.log_odds
    if len(index) and not -CENTRE_KEY <= index.min() <= index.max() < CENTRE_KEY:
        raise OutputError(
            f"{path.name}: the map reaches {np.abs(index).max() * voxels.voxel_m:.0f} m from the "
            f"origin and OctoMap holds {CENTRE_KEY * voxels.voxel_m:.0f} m at this voxel size; "
            "write .zarr instead"
        )
    if path.suffix == ".bt":
        levels = pruned_tree(index, np.where(value > 0, OCCUPIED_LOG_ODDS, FREE_LOG_ODDS))
        data = _binary_nodes(levels)
    else:
        # OctoMap calls log-odds of exactly 0 occupied, we do not
        levels = pruned_tree(index, np.where(value == 0, -_LEAST, value))
        data = _float_nodes(levels)
    size = sum(len(level.code) for level in levels)
    head = f"\n# written by insonify\nid OcTree\nsize {size}\nres {voxels.voxel_m!r}\ndata\n"
    path.write_bytes(_TITLE[path.suffix] + head.encode() + data)
    save_origin(voxels, path)


def load_octomap(path: Path) -> VoxelMap:
    """Read an OctoMap ``.bt`` or ``.ot``; every voxel in it counts as observed.

    Raises:
        MapFileError: The file is no such tree, or is damaged.
    """
    with reading(path, "an OctoMap", MapFileError):
        content = path.read_bytes()
    voxel_m, size, start = _read_header(path, content)
    binary = path.suffix == ".bt"
    data = np.frombuffer(content, np.uint8)[start:]
    if size > (1 + 4 * len(data) if binary else len(data) // 5):
        raise MapFileError(f"{path}: damaged, it cannot hold the {size} nodes that it announces")
    read = _read_binary_nodes if binary else _read_float_nodes
    state, nodes, used, code, depth, value = read(data, size)
    if state == _DEEP:
        raise MapFileError(f"{path}: damaged, its tree is deeper than {DEPTH} levels")
    if state != _WHOLE or nodes != size or used != len(data):
        raise MapFileError(f"{path}: damaged, its nodes are not the {size} that it announces")
    if not (np.abs(value) <= MOST_LOG_ODDS).all():
        raise MapFileError(f"{path}: damaged, it holds log-odds beyond {MOST_LOG_ODDS:g}")
    most = LEAST_BLOCKS + BLOCKS_PER_BYTE * len(content)
    return _map_from_leaves(path, voxel_m, code, depth, value, most)


def _float_nodes(levels: list[Level]) -> bytes:
    found = places(levels, 5, 5) if levels else []
    data = np.empty(5 * sum(len(level.code) for level in levels), np.uint8)
    for level, place in zip(levels, found, strict=True):
        data[place[:, None] + np.arange(4)] = level.value.astype("<f4")[:, None].view(np.uint8)
        data[place + 4] = level.children
    return data.tobytes()


def _binary_nodes(levels: list[Level]) -> bytes:
    found = places(levels, 0, 2) if levels else []
    bits = [np.zeros(len(level.code), np.uint16) for level in levels]
    for depth in range(1, len(levels)):
        level = levels[depth]
        kind = np.where(level.children > 0, 3, np.where(level.value > 0, 2, 1)).astype(np.uint16)
        np.add.at(bits[depth - 1], level.parent, kind << (2 * (level.code & 7)).astype(np.uint16))
    inner = [level.children > 0 for level in levels]
    data = np.empty(2 * sum(int(i.sum()) for i in inner), np.uint8)
    for mask, place, pairs in zip(inner, found, bits, strict=True):
        data[place[mask][:, None] + np.arange(2)] = (
            pairs[mask].astype("<u2")[:, None].view(np.uint8)
        )
    return data.tobytes()


def _read_header(path: Path, content: bytes) -> tuple[float, int, int]:
    """Resolution, number of nodes, and where the nodes begin."""
    head, found, _ = content[:_LONGEST_HEADER].partition(b"\ndata\n")
    lines = head.split(b"\n")
    if not found or lines[0].rstrip() != _TITLE[path.suffix]:
        raise MapFileError(f"{path}: damaged, or not an OctoMap {path.suffix} file")
    fields = dict(
        line.decode("ascii", "replace").split(None, 1)
        for line in lines[1:]
        if not line.startswith(b"#") and len(line.split(None, 1)) == 2
    )
    if fields.get("id", "").strip() != "OcTree":
        raise MapFileError(
            f"{path}: holds a tree of the kind {fields.get('id', '')!r:.60}; only OcTree is read"
        )
    try:
        voxel_m, size = float(fields["res"]), int(fields["size"])
    except (KeyError, ValueError) as err:
        raise MapFileError(f"{path}: damaged, its header lacks a resolution or a size") from err
    check_voxel(path, voxel_m)
    if size < 0:
        raise MapFileError(f"{path}: damaged, it announces {size} nodes")
    return voxel_m, size, len(head) + len(found)


def _map_from_leaves(
    path: Path, voxel_m: float, code: Int64, depth: Array, value: Float32, most: int
) -> VoxelMap:
    """A map of leaves of any depth; one above a block's depth fills whole blocks."""
    across = 3 * np.maximum(_BLOCK_DEPTH - depth.astype(np.int64), 0)
    unfolded = float((2.0**across).sum()) if (depth < _BLOCK_DEPTH).any() else 0.0
    if unfolded > most:
        raise MapFileError(
            f"{path}: its {path.stat().st_size:,} bytes unfold to {unfolded:.3g} blocks, more than "
            f"{most:,}; write the map with finer leaves if it is meant"
        )
    check_memory(path, int(unfolded))
    first = code << (3 * (DEPTH - depth).astype(np.int64))
    found = [first[:0]]
    for d in np.unique(depth):
        beside = np.arange(1 << 3 * max(_BLOCK_DEPTH - int(d), 0))
        found.append(np.unique((first[depth == d] >> 9)[:, None] + beside))
    blocks = np.unique(np.concatenate(found))
    check_memory(path, len(blocks))
    voxels = VoxelMap(voxel_m, origin_m=load_origin(path))
    keys = separate(blocks) - (CENTRE_KEY >> 3)
    slots = voxels.allocate(keys.astype(np.int32))
    value = np.where(np.abs(value) <= _LEAST, np.float32(0.0), value)
    within = np.ravel_multi_index(
        tuple(separate(np.arange(VOXELS_PER_BLOCK)).T), (BLOCK, BLOCK, BLOCK)
    )
    for d in np.unique(depth):
        leaf, known = first[depth == d], value[depth == d]
        row = np.searchsorted(blocks, leaf >> 9)
        if d < _BLOCK_DEPTH:
            rows = slots[row[:, None] + np.arange(1 << 3 * (_BLOCK_DEPTH - int(d)))]
            voxels.log_odds[rows] = known[:, None, None]
            voxels.seen[rows] = IN_VIEW | OBSERVED
        else:
            column = within[(leaf & 511)[:, None] + np.arange(1 << 3 * (DEPTH - int(d)))]
            voxels.log_odds[slots[row][:, None], column] = known[:, None]
            voxels.seen[slots[row][:, None], column] = IN_VIEW | OBSERVED
    return voxels


@kernel
def _read_float_nodes(data: Array, size: int) -> tuple[int, int, int, Int64, Array, Float32]:
    """Walk an ``.ot``: how it ended, nodes and bytes read, and code, depth, value of each leaf."""
    codes, depths = np.empty(size, np.int64), np.empty(size, np.int8)
    values = np.empty(size, np.float32)
    raw = np.empty(4, np.uint8)
    masks, parents = np.zeros(18, np.int64), np.zeros(18, np.int64)
    masks[0] = 1
    level, nodes, leaves, at, state = 0, 0, 0, 0, 0
    if size == 0:
        level = -1
    while level >= 0:
        if masks[level] == 0:
            level -= 1
            continue
        child = 0
        while not masks[level] & (1 << child):
            child += 1
        masks[level] -= 1 << child
        if nodes == size:
            state = 3
            break
        if at + 5 > len(data):
            state = 1
            break
        code = (parents[level] << 3) | child
        nodes += 1
        if data[at + 4] == 0:
            raw[:] = data[at : at + 4]
            codes[leaves], depths[leaves], values[leaves] = code, level, raw.view(np.float32)[0]
            leaves += 1
        elif level == 16:
            state = 2
            break
        else:
            masks[level + 1], parents[level + 1] = data[at + 4], code
            level += 1
        at += 5
    return state, nodes, at, codes[:leaves], depths[:leaves], values[:leaves]


@kernel
def _read_binary_nodes(data: Array, size: int) -> tuple[int, int, int, Int64, Array, Float32]:
    """Walk a ``.bt``, as `_read_float_nodes` does an ``.ot``."""
    codes, depths = np.empty(size, np.int64), np.empty(size, np.int8)
    values = np.empty(size, np.float32)
    masks, parents = np.zeros(18, np.int64), np.zeros(18, np.int64)
    masks[0] = 1
    level, nodes, leaves, at, state = 0, 0, 0, 0, 0
    if size == 0:
        level = -1
    else:
        nodes = 1
    while level >= 0:
        if masks[level] == 0:
            level -= 1
            continue
        child = 0
        while not masks[level] & (1 << child):
            child += 1
        masks[level] -= 1 << child
        if at + 2 > len(data):
            state = 1
            break
        if level == 16:
            state = 2
            break
        code = (parents[level] << 3) | child
        bits = np.int64(data[at]) | (np.int64(data[at + 1]) << 8)
        at += 2
        inner = 0
        for i in range(8):
            kind = (bits >> (2 * i)) & 3
            if kind == 0:
                continue
            if nodes == size:
                state = 3
                break
            nodes += 1
            if kind == 3:
                inner |= 1 << i
            else:
                codes[leaves], depths[leaves] = (code << 3) | i, level + 1
                values[leaves] = 3.5 if kind == 2 else -2.0
                leaves += 1
        if state != 0:
            break
        masks[level + 1], parents[level + 1] = inner, code
        level += 1
    return state, nodes, at, codes[:leaves], depths[:leaves], values[:leaves]
