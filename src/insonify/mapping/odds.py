"""From voxels inside to those of the map: how likely each is part of an object, by a table.

A voxel of the map holds several inside.  What counts is how many of them are free, how many are
around it, how many lie, without free ones between, at or below one that was heard before the seabed
could be, and whether any around it do, from how many sides it was looked at, whether the papers'
update holds it for occupied, and whether poses were in doubt.  For each such case the table says in
which share of all voxels, over objects whose shape is known, the voxel belongs to the object, and
in which to its surface.  So where few sides were seen, and rays cut away too little or too much,
the papers' update has its say.
`benchmarks.calibration` learns the table.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from insonify.jit import kernel, parallel_kernel, prange
from insonify.mapping.store import BLOCK, VOXELS_PER_BLOCK, MemoryStore
from insonify.mapping.visibility import HEARD_EARLY, LOOKED_AT
from insonify.mapping.voxels import IN_VIEW, OBSERVED, SURFACE, VoxelMap
from insonify.types import Array, Float32, Int32, Int64

FREE = -0.9
"""A voxel inside is free below these log-odds: one ray has passed it."""
_CLASSES = (9, 6, 3, 3, 2, 2, 2)
"""Of each of these, in this order."""
CASES = math.prod(_CLASSES)
_NEAR_EDGES = (0.5 / 8, 2.0 / 8, 3.5 / 8, 5.0 / 8, 6.5 / 8)
_COVERED_EDGES = (0.5 / 8, 3.5 / 8)
_SURFACE_SHARE = 0.4
"""Share of a case's voxels from which it counts as surface."""
DOUBTED = 1 << 8
"""Bit of a block that was in view from a pose which may be off by half a voxel inside or more."""
_TABLE = "odds.json"


@cache
def odds_table() -> Float32:
    """(CASES, 2): log-odds of being part of an object; 1 where it counts as surface, else 0."""
    table = json.loads(resources.files("insonify.mapping").joinpath(_TABLE).read_text("utf-8"))
    solid, surface = (np.reshape(table[name], CASES) for name in ("solid", "surface"))
    odds = np.log(solid / (1.0 - solid))
    return np.column_stack([odds, surface >= _SURFACE_SHARE]).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What is known of the voxels inside, and by the papers' update of the map's own.

    Attributes:
        inside: Voxels inside along an edge of one of the map's.
        fine: Voxels inside: log-odds, and the bits of `insonify.mapping.visibility`.
        views: (fine blocks or more,) from which of eight sides each block was in view, as bits, and
            whether it is `DOUBTED`.
        papers: The papers' map.
    """

    inside: int
    fine: MemoryStore
    views: Array
    papers: VoxelMap


def read_off(evidence: Evidence, coarse: MemoryStore, columns: Int32, table: Float32) -> None:
    """Write the map's voxels of some columns of blocks.

    Args:
        evidence: What they are read off.
        coarse: Those of the map, written.
        columns: (C, 2) columns of the map's blocks.
        table: See `odds_table`.
    """
    inside, coords = evidence.inside, evidence.fine.coords
    low = np.array([*(columns.min(axis=0) - 1), coords[:, 2].min() // inside], np.int64)
    high = np.array([*(columns.max(axis=0) + 2), coords[:, 2].max() // inside + 1], np.int64)
    near = ((coords >= low * inside) & (coords < high * inside)).all(axis=1)
    index = np.full(tuple((high - low) * inside), -1, np.int32)
    index[tuple((coords[near] - low * inside).T)] = np.flatnonzero(near)
    wanted = np.zeros(tuple(high - low), bool)
    wanted[tuple((coords[near] // inside - low).T)] = True
    inner = np.zeros(wanted.shape[:2], bool)
    inner[tuple((columns - low[:2]).T)] = True
    blocks = np.argwhere(wanted & inner[:, :, None])
    slots = np.full((2, *wanted.shape), -1, np.int64)
    slots[(0, *blocks.T)] = coarse.find((blocks + low).astype(np.int32))
    slots[(1, *blocks.T)] = evidence.papers.find((blocks + low).astype(np.int32))
    _read_columns(
        np.unique(blocks[:, :2], axis=0),
        index,
        slots,
        (evidence.fine.log_odds, evidence.fine.seen, evidence.views),
        (evidence.papers.log_odds, evidence.papers.seen),
        inside,
        table,
        (coarse.log_odds, coarse.seen),
    )


@kernel
def _ones(bits: int) -> int:
    count = 0
    for bit in range(8):
        count += (bits >> bit) & 1
    return count


@kernel
def case_of(
    free: float, near: float, covered: float, views: int, occupied: bool, beside: bool
) -> int:
    """Row of the table.

    Args:
        free: Share of the voxels inside that are free.
        near: The same over the 27 voxels around.
        covered: Share that is not free and lies at or below one that was heard early.
        views: From which of eight sides it was in view, and whether it is `DOUBTED`, as bits.
        occupied: Whether the papers' update holds it for occupied.
        beside: Whether any of the 27 around it has such a share.
    """
    case = round(free * (_CLASSES[0] - 1))
    level = 0
    for edge in _NEAR_EDGES:
        level += near > edge
    case = case * _CLASSES[1] + level
    level = 0
    for edge in _COVERED_EDGES:
        level += covered > edge
    case = case * _CLASSES[2] + level
    sides = _ones(views)
    case = case * _CLASSES[3] + (sides >= 4) + (sides >= 7)
    case = (case * _CLASSES[4] + occupied) * _CLASSES[5] + beside
    return case * _CLASSES[6] + (views & DOUBTED > 0)


@parallel_kernel
def _read_columns(
    places: Int64,
    index: Int32,
    slots: Int64,
    fine: tuple[Float32, Array, Array],
    papers: tuple[Float32, Array],
    inside: int,
    table: Float32,
    out: tuple[Float32, Array],
) -> None:
    """Columns of the map's blocks, each by one iteration, from the top down."""
    log_odds, seen, views = fine
    height = slots.shape[3] * BLOCK
    for place in prange(len(places)):
        x, y = places[place]
        free = np.zeros((BLOCK + 2, BLOCK + 2, height + 2), np.float32)
        covered = np.zeros((BLOCK + 2, BLOCK + 2, height + 2), np.float32)
        bits = np.zeros((BLOCK, BLOCK, height), np.uint8)
        _gather(x, y, index, log_odds, seen, inside, free, covered, bits)
        for bz in range(slots.shape[3]):
            slot, theirs = slots[0, x, y, bz], slots[1, x, y, bz]
            if slot < 0:
                continue
            for k in range(VOXELS_PER_BLOCK):
                i, j, z = k >> 6, (k >> 3) & 7, bz * BLOCK + (k & 7)
                under = covered[i + 1, j + 1, z + 1]
                known = papers[1][theirs, k] if theirs >= 0 else 0
                if not (bits[i, j, z] & LOOKED_AT or under > 0.0 or known & OBSERVED):
                    out[0][slot, k], out[1][slot, k] = 0.0, known & IN_VIEW
                    continue
                near, beside = np.float32(0.0), False
                for a in range(3):
                    for b in range(3):
                        for c in range(3):
                            near += free[i + a, j + b, z + c]
                            beside |= covered[i + a, j + b, z + c] > 0.0
                bx, by = (x * BLOCK + i) * inside >> 3, (y * BLOCK + j) * inside >> 3
                block = index[bx, by, z * inside >> 3]
                around = int(views[block]) if block >= 0 else 0
                occupied = theirs >= 0 and papers[0][theirs, k] > 0.0
                share = float(near) / 27.0
                case = case_of(free[i + 1, j + 1, z + 1], share, under, around, occupied, beside)
                out[0][slot, k] = table[case, 0]
                out[1][slot, k] = known | OBSERVED | (SURFACE if table[case, 1] > 0.0 else 0)


@kernel
def _gather(
    x: int,
    y: int,
    index: Int32,
    log_odds: Float32,
    seen: Array,
    inside: int,
    free: Float32,
    covered: Float32,
    bits: Array,
) -> None:
    """What a column of blocks and its rim hold, as shares of each voxel of the map."""
    share = np.float32(1.0 / inside**3)
    tall = index.shape[2] * BLOCK
    for i in range(-1, BLOCK + 1):
        for j in range(-1, BLOCK + 1):
            rim = i < 0 or j < 0 or i == BLOCK or j == BLOCK
            for f in range(inside * inside):
                fx = (x * BLOCK + i) * inside + f // inside
                fy = (y * BLOCK + j) * inside + f % inside
                bx, by = fx >> 3, fy >> 3
                corner = ((fx & 7) << 6) | ((fy & 7) << 3)
                under = False
                for fz in range(tall - 1, -1, -1):
                    slot = index[bx, by, fz >> 3]
                    if slot < 0:
                        under = False
                        continue
                    voxel = corner | (fz & 7)
                    z = fz // inside
                    is_free = log_odds[slot, voxel] < FREE
                    if is_free:
                        free[i + 1, j + 1, z + 1] += share
                        under = False
                    here = seen[slot, voxel]
                    under = under or (here & HEARD_EARLY > 0 and not is_free)
                    if under:
                        covered[i + 1, j + 1, z + 1] += share
                    if not rim:
                        bits[i, j, z] |= here
