"""What each voxel of a fan showed in one ping: dark, lit, or perhaps the cause of a shadow.

A ray is cast for each beam and elevation; near the sonar, where nothing is heard yet, for fewer.  A
pixel that is dark shows that nothing is at its range anywhere in its arc that can be seen; so all
that a ray meets is free up to the first voxel whose pixel is lit, unless that voxel is known to be
free, for then the light is from elsewhere in the arc.  The seabed tells more.  Where a ray meets it
and it is dark, something of what is lit on the ray's way throws a shadow.  Where it is heard, and
nothing that throws shadows could be heard in its place, the ray went all its way: what it met is
free, lit or not.

Before the least range at which a beam's rays come near the seabed, an echo is an object's, and what
stops a ray there was heard early.  An echo from farther may be the seabed's.
"""

from __future__ import annotations

import math

import numpy as np

from insonify.jit import kernel, parallel_kernel, prange
from insonify.mapping.voxels import BLOCK, VOXELS_PER_BLOCK
from insonify.types import Array, Bool, Float32, Float64, Int32, Int64

DARK, LIT, SHADOW, EARLY = 0, 1, 2, 3
"""Rows of a ping's marks."""
ROWS = 4
LOOKED_AT, EVER_LIT, THROWS_SHADOW, HEARD_EARLY = 1, 2, 4, 8
"""Bits of what was seen of a voxel inside."""
_AROUND = 2
"""Bins to either side of where a ray meets the seabed that are asked whether it is heard."""
_HEARD = 4
"""How many of those must be lit in the ray's beam and its neighbours."""
_APART = 4
"""Bins within which another voxel may be what is heard in place of the seabed."""
_UNCUT = 0.05
"""Log-odds above which a voxel may throw shadows: lit so far, and never seen to be free."""
_EARLY_M = 0.12
"""An echo from so far before the ranges at which the seabed can be heard is not the seabed's."""
_NEVER_M = 1e30
_CHORD = 0.5
"""Of a voxel's edge: a ray that crosses less of it does not show that it is free."""
_RAYS = 8
"""Azimuths that share buffers."""
_PASSES, _STOPS, _GRAZES, _SHADES = 1, 2, 4, 8


@kernel
def count_pixels(
    image: Float32, threshold: np.float32, along: int, aside: int
) -> tuple[Int32, Int32]:
    """Running counts, from the first bin, of pixels that may be echoes and of those that are.

    Args:
        image: (bins, beams) in [0, 1]; not a number where nothing is known.
        threshold: Brighter pixels are echoes.
        along: A pixel so many bins from an echo may be one.
        aside: And one so many beams from it.

    Returns:
        Two of (beams, bins + 1); unknown pixels count in the first alone.
    """
    bins, beams = image.shape
    maybe = np.zeros((beams, bins + 1), np.int32)
    surely = np.zeros((beams, bins + 1), np.int32)
    for beam in range(beams):
        for cell in range(bins):
            pixel = image[cell, beam]
            maybe[beam, cell + 1] = maybe[beam, cell] + (not pixel <= threshold)
            surely[beam, cell + 1] = surely[beam, cell] + (pixel > threshold)
    if along or aside:
        maybe = _widened(maybe, along, aside)
    return maybe, surely


@kernel
def _widened(counts: Int32, along: int, aside: int) -> Int32:
    """Running counts of pixels with one that counts within some bins and beams of them."""
    beams, bins = counts.shape[0], counts.shape[1] - 1
    wide = np.zeros_like(counts)
    for beam in range(beams):
        for cell in range(bins):
            first, last = max(cell - along, 0), min(cell + along + 1, bins)
            found = False
            for near in range(max(beam - aside, 0), min(beam + aside + 1, beams)):
                found |= counts[near, last] > counts[near, first]
            wide[beam, cell + 1] = wide[beam, cell] + found
    return wide


@parallel_kernel
def look(
    index: Int32,
    first: Int64,
    slots: Int64,
    log_odds: Float32,
    seen: Array,
    transform: Float64,
    fan: Float64,
    angles: tuple[Float64, Float64],
    voxel_m: float,
    counts: tuple[Int32, Int32],
    seabed: tuple[Float64, Bool, float],
    known_free: float,
    marks: Array,
) -> None:
    """Mark what one ping shows of the voxels of its fan.

    Threads may set the same mark, to the same value, so that their order does not matter.

    Args:
        index: (nx, ny, nz) row in ``slots`` and ``marks`` of each block of a box; -1 for none.
        first: (3,) index of the box's first block.
        slots: (blocks,) where each is in the map.
        log_odds: (slots, 512) of the map; ``seen`` likewise.
        seen: See `THROWS_SHADOW`.
        transform: ``world_from_sonar``, (4, 4).
        fan: See `fan_vector`.
        angles: Azimuths and elevations of the rays, radians.
        voxel_m: Edge length.
        counts: See `count_pixels`.
        seabed: (nx, ny) its height under the box's columns, metres, whether that is certain
            enough to judge shadows by, and how far above it rays end.
        known_free: Voxels below these log-odds are known to be free.
        marks: (ROWS, blocks, 512) uint8, written: DARK, LIT, SHADOW and EARLY.
    """
    azimuths, elevations = angles
    maybe, surely = counts
    heights, certain, zone_m = seabed
    beams, bins = maybe.shape[0], maybe.shape[1] - 1
    range_min_m, bin_m = fan[2], fan[4]
    range_max_m = range_min_m + bins * bin_m
    longest = int(1.8 * range_max_m / voxel_m) + 16
    floors = np.empty(heights.shape, np.int64)
    for x in range(heights.shape[0]):
        for y in range(heights.shape[1]):
            top_m = max(heights[x, y] + zone_m, -1e6)
            floors[x, y] = math.ceil(top_m / voxel_m - 0.5) - first[2] * BLOCK
    sooner = int(_EARLY_M / bin_m)
    parts = (len(azimuths) + _RAYS - 1) // _RAYS
    for part in prange(parts):
        met = np.empty((len(elevations), longest), np.int64)
        cells = np.empty((len(elevations), longest), np.int32)
        steps = np.zeros(len(elevations), np.int64)
        meets = np.empty(len(elevations), np.int64)
        rivals = np.empty(bins, np.uint8)
        for ray in range(part * _RAYS, min((part + 1) * _RAYS, len(azimuths))):
            beam = min(int((fan[0] - azimuths[ray]) / fan[3]), beams - 1)
            rivals[:] = 0
            early, quiet_m = bins, _quiet_m(maybe[beam], range_min_m, bin_m)
            for e in range(len(elevations)):
                start_m = min(quiet_m - voxel_m, max(_thinned(e), _thinned(ray)) * range_max_m)
                steps[e], meets[e], reaches = _walk(
                    index, first, slots, log_odds, seen, transform, azimuths[ray], elevations[e],
                    max(start_m, range_min_m, 1e-3), voxel_m, maybe[beam], range_min_m, bin_m,
                    range_max_m, heights, certain, floors, known_free, met[e], cells[e], rivals,
                    marks,
                )  # fmt: skip
                silent = meets[e] >= 0 and (
                    maybe[beam, meets[e] + _AROUND + 1] == maybe[beam, meets[e] - _AROUND]
                )
                early = min(early, reaches - sooner)
                if silent:
                    _throw(met[e], cells[e], steps[e], marks, rivals)
            for e in range(len(elevations)):
                through = meets[e] >= 0 and _seabed_heard(surely, rivals, beam, meets[e])
                _mark(met[e], cells[e], steps[e], through, early, marks)


@kernel
def _quiet_m(maybe: Int32, range_min_m: float, bin_m: float) -> float:
    """Range up to which nothing is heard in a beam."""
    cell = 0
    while cell < len(maybe) - 1 and maybe[cell + 1] == 0:
        cell += 1
    return range_min_m + cell * bin_m


@kernel
def _thinned(number: int) -> float:
    """Share of the range at which the rays of a number are first needed to leave out no voxel."""
    if number == 0:
        return 0.0
    share = 0.5
    while number & 1 == 0:
        number, share = number >> 1, share * 0.5
    return share


@kernel
def _throw(met: Int64, cells: Int32, count: int, marks: Array, rivals: Array) -> None:
    """Mark what may throw the shadow in which a ray meets the seabed."""
    for s in range(count):
        if met[s] & _SHADES:
            marks[SHADOW, met[s] >> 13, (met[s] >> 4) & 511] = 1
            rivals[cells[s]] = 1


@kernel
def _mark(met: Int64, cells: Int32, count: int, through: bool, early: int, marks: Array) -> None:
    """Mark what a ray shows, up to the first voxel that stops it."""
    for s in range(count):
        block, voxel = met[s] >> 13, (met[s] >> 4) & 511
        if through or met[s] & _PASSES:
            if not met[s] & _GRAZES:
                marks[DARK, block, voxel] = 1
        else:
            marks[LIT, block, voxel] = 1
            if met[s] & _STOPS:
                if cells[s] < early:
                    marks[EARLY, block, voxel] = 1
                break


@kernel
def _seabed_heard(surely: Int32, rivals: Array, beam: int, cell: int) -> bool:
    """Whether the seabed is heard in a beam and its neighbours, and nothing in its place can be."""
    for near in range(max(beam - 1, 0), min(beam + 2, surely.shape[0])):
        if surely[near, cell + _AROUND + 1] - surely[near, cell - _AROUND] < _HEARD:
            return False
    for other in range(max(cell - _APART, 0), min(cell + _APART + 1, len(rivals))):
        if rivals[other]:
            return False
    return True


@kernel
def _walk(
    index: Int32,
    first: Int64,
    slots: Int64,
    log_odds: Float32,
    seen: Array,
    transform: Float64,
    azimuth: float,
    elevation: float,
    start_m: float,
    voxel_m: float,
    maybe: Int32,
    range_min_m: float,
    bin_m: float,
    range_max_m: float,
    heights: Float64,
    certain: Bool,
    floors: Int64,
    known_free: float,
    met: Int64,
    cells: Int32,
    rivals: Array,
    marks: Array,
) -> tuple[int, int, int]:
    """Walk a ray through the voxels of a box down to the seabed or the end of the range.

    Of each voxel its row in ``marks``, its place in the block and its kind are written as bits of
    ``met``, and the bin of one that may stop it; one that threw a shadow before is a rival of its
    bins.

    Returns:
        Number of voxels; the bin at which the ray meets a seabed that is certain, if the image
        holds the bins around it, -1 if not; and the bin at which it comes near any seabed.
    """
    bins = len(maybe) - 1
    flat, up = math.cos(elevation), math.sin(elevation)
    ahead, aside = flat * math.cos(azimuth), flat * math.sin(azimuth)
    dx = transform[0, 0] * ahead + transform[0, 1] * aside + transform[0, 2] * up
    dy = transform[1, 0] * ahead + transform[1, 1] * aside + transform[1, 2] * up
    dz = transform[2, 0] * ahead + transform[2, 1] * aside + transform[2, 2] * up
    x, step_x, next_x, each_x = _first_plane(transform[0, 3], dx, start_m, voxel_m, first[0])
    y, step_y, next_y, each_y = _first_plane(transform[1, 3], dy, start_m, voxel_m, first[1])
    z, step_z, next_z, each_z = _first_plane(transform[2, 3], dz, start_m, voxel_m, first[2])
    count, per_m = 0, 1.0 / bin_m
    entry, cell = start_m, int((start_m - range_min_m) * per_m)
    bx, by, bz = -1, -1, -1
    row, slot, floor = -1, -1, 0
    grazing = _CHORD * voxel_m
    while entry < range_max_m and count < len(met):
        if ((x >> 3) ^ bx) | ((y >> 3) ^ by) | ((z >> 3) ^ bz):
            bx, by, bz = x >> 3, y >> 3, z >> 3
            inside = 0 <= bx < index.shape[0] and 0 <= by < index.shape[1]
            if not inside or bz < 0 or bz >= index.shape[2]:
                break
            row, floor = int(index[bx, by, bz]), int(floors[bx, by])
            slot = int(slots[row]) if row >= 0 else -1
        leave = min(next_x, next_y, next_z, range_max_m)
        last = min(int((leave - range_min_m) * per_m), bins - 1)
        if row >= 0:
            voxel = ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)
            lit = maybe[last + 1] > maybe[cell]
            if z < floor:
                if lit:
                    marks[LIT, row, voxel] = 1
                meets = int(((heights[bx, by] - transform[2, 3]) / dz - range_min_m) * per_m)
                if certain[bx, by] and _AROUND <= meets < bins - _AROUND:
                    return count, meets, cell
                return count, -1, cell
            kind = _GRAZES * (leave - entry < grazing)
            if not lit:
                kind |= _PASSES
            elif not log_odds[slot, voxel] < known_free:
                kind |= _STOPS
                cells[count] = cell
                if log_odds[slot, voxel] > _UNCUT:
                    kind |= _SHADES
                    if seen[slot, voxel] & THROWS_SHADOW:
                        for c in range(cell, last + 1):
                            rivals[c] = 1
            met[count] = (((np.int64(row) << 9) | voxel) << 4) | kind
            count += 1
        entry, cell = leave, last
        # without branches, which a processor could not foresee
        over_x, over_y, over_z = next_x <= leave, next_y <= leave, next_z <= leave
        x, next_x = x + step_x * over_x, next_x + each_x * over_x
        y, next_y = y + step_y * over_y, next_y + each_y * over_y
        z, next_z = z + step_z * over_z, next_z + each_z * over_z
    return count, -1, bins


@kernel
def _first_plane(
    origin_m: float, direction: float, start_m: float, voxel_m: float, first: int
) -> tuple[int, int, float, float]:
    """Along an axis: first voxel, step, range to the next plane, and from one to another."""
    place = (origin_m + start_m * direction) / voxel_m - first * BLOCK
    at = math.floor(place)
    if direction > 1e-12:
        return at, 1, start_m + (at + 1 - place) * voxel_m / direction, voxel_m / direction
    if direction < -1e-12:
        return at, -1, start_m + (at - place) * voxel_m / direction, -voxel_m / direction
    return at, 0, _NEVER_M, _NEVER_M


@parallel_kernel
def vote(
    slots: Int64, log_odds: Float32, seen: Array, marks: Array, votes: Float32, limits: Float32
) -> None:
    """Add a ping's marks to the map, one vote a voxel, and wipe them.

    Args:
        slots: (blocks,).
        log_odds: (slots, 512); ``seen`` likewise.
        seen: Bits.
        marks: See `look`.
        votes: (slots, 2) of a dark voxel and of a lit one.
        limits: The least and greatest log-odds.
    """
    for i in prange(len(slots)):
        if not marks[:, i].any():
            continue
        cells, bits = log_odds[slots[i]], seen[slots[i]]
        for k in range(VOXELS_PER_BLOCK):  # without branches, so that it vectorises
            lit, dark = marks[LIT, i, k], marks[DARK, i, k]
            louder = min(cells[k] + votes[i, 1], limits[1])
            quieter = max(cells[k] + votes[i, 0], limits[0])
            cells[k] = louder if lit else (quieter if dark else cells[k])
            bits[k] |= (
                (lit | dark) * LOOKED_AT
                | lit * EVER_LIT
                | marks[SHADOW, i, k] * THROWS_SHADOW
                | marks[EARLY, i, k] * HEARD_EARLY
            )
        marks[:, i] = 0
