"""The papers' map update: threshold, read outward, add log-odds (Park et al. 2025, eq. 1 and 2).

Eq. 1 lets every voxel be updated alone; eq. 2 in log-odds is an addition.  A pixel over the
threshold is evidence of occupancy for every voxel of its elevation arc.  In each column the
pixels before the first occupied one are evidence of free space; the empty pixels behind it lie in
shadow and say nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from insonify.frames import world_from_sonar
from insonify.jit import kernel, parallel_kernel, prange
from insonify.mapping.fan import blocks_in_fan, fan_vector
from insonify.mapping.mapper import MappingSettings, Shown
from insonify.mapping.sight import before_the_first_occupied
from insonify.mapping.voxels import BLOCK, IN_VIEW, OBSERVED, VOXELS_PER_BLOCK, VoxelMap
from insonify.mapping.witness import Witness
from insonify.types import Array, FanGeometry, Float32, Float64, Int32, Int64, Ping, Pose


class BayesMapper:
    """The papers' mapper: each ping adds log-odds to every voxel it speaks about.

    It also serves as the base of mappers that change one thing of it.

    Attributes:
        settings: As given.
        voxels: The map.
        within: From which block to which (3,), both included, it maps alone; by default all.
            Whatever these are, what is mapped of a block is the same.
    """

    name = "bayes"

    def __init__(self, settings: MappingSettings, voxels: VoxelMap | None = None) -> None:
        """An empty map, or one to go on with."""
        self.settings = settings
        self.within: tuple[Int32, Int32] | None = None
        self.voxels = VoxelMap(settings.voxel_m) if voxels is None else voxels
        bayes = settings.bayes
        self._evidence = np.array(
            [
                log_odds(bayes.p_free),
                log_odds(bayes.p_occupied),
                log_odds(bayes.p_min),
                log_odds(bayes.p_max),
            ],
            np.float32,
        )

    def integrate(self, ping: Ping, pose: Pose) -> None:
        """Update every voxel inside the fan (eq. 2)."""
        geometry = ping.geometry
        transform = world_from_sonar(pose, geometry.mount)
        blocks = blocks_in_fan(transform, geometry, self.voxels.block_m, self.within)
        if not len(blocks):
            return
        # neighbours far apart in the list: two threads then share near and far blocks evenly
        blocks = np.ascontiguousarray(np.vstack([blocks[::2], blocks[1::2]]))
        held = self.voxels.hold(blocks)
        echoes, first = count_echoes(ping.image, np.float32(self.settings.pixel_threshold / 255.0))
        _update(
            held.slots,
            blocks,
            held.log_odds,
            held.seen,
            transform,
            fan_vector(geometry),
            self.voxels.voxel_m,
            echoes,
            first,
            self._evidence,
        )

    def explain(self, ping: Ping, pose: Pose, voxel: tuple[int, int, int]) -> Shown:
        """Update the map, and tell what the ping showed of a voxel (an `Explains`)."""
        witness = Witness(self.voxels, np.array([voxel]), IN_VIEW | OBSERVED)
        self.integrate(ping, pose)
        told = bool(witness.dismiss()[0] & OBSERVED)
        after, _ = self.voxels.at(voxel)
        change = after - float(witness.log_odds[0])
        lit = change > 0.0 or (change == 0.0 and after > 0.0)  # at a clamp nothing changes
        return Shown(int(told and lit), int(told and not lit), 1, after)

    def finish_scan(self) -> None:
        """Nothing: every ping has been used when it came."""

    def tells(self, poses: Sequence[Pose], geometry: FanGeometry, voxels_m: Float64) -> Float32:
        """1 for a voxel before the first occupied one of its beam, else 0 (M_b of eq. 6)."""
        return before_the_first_occupied(self.voxels, poses, geometry, voxels_m)

    def save(self) -> dict[str, Array]:
        """Nothing: the map is all that it knows."""
        return {}

    def load(self, arrays: Mapping[str, Array]) -> None:
        """Go on with the map alone."""


def log_odds(probability: float) -> float:
    """ln(p / (1 - p))."""
    return math.log(probability / (1.0 - probability))


@kernel
def count_echoes(image: Float32, threshold: np.float32) -> tuple[Int32, Int32]:
    """Running count of occupied pixels of each column, and its first occupied bin.

    Args:
        image: (bins, beams) in [0, 1]; not a number where nothing is known.
        threshold: Brighter pixels are occupied.

    Returns:
        (beams, bins + 1) counts before each bin, and (beams,) first bin that is occupied or not
        known, ``bins`` if none: what lies behind says nothing.
    """
    bins, beams = image.shape
    counts = np.zeros((beams, bins + 1), np.int32)
    first = np.full(beams, bins, np.int32)
    for beam in range(beams):  # the simulator's images lie beam by beam in memory
        for cell in range(bins):
            occupied = image[cell, beam] > threshold
            counts[beam, cell + 1] = counts[beam, cell] + occupied
            if first[beam] == bins and not image[cell, beam] <= threshold:
                first[beam] = cell
    return counts, first


@kernel
def _angle_ahead(y: np.float32, x: np.float32, flat: np.float32) -> np.float32:
    """atan2(y, x) in single precision for x > 0, where ``flat`` is the length of (x, y).

    Two half-angle steps bring the tangent below 0.415, where Taylor's series is short.  Unlike a
    call to atan2 this vectorises, which makes the map update twice as fast.
    """
    one = np.float32(1.0)
    along = flat + abs(x)
    t = y / (along + math.sqrt(along * along + y * y))
    s = t * t
    series = one / np.float32(15.0)
    series = one / np.float32(13.0) - s * series
    series = one / np.float32(11.0) - s * series
    series = one / np.float32(9.0) - s * series
    series = one / np.float32(7.0) - s * series
    series = one / np.float32(5.0) - s * series
    series = one / np.float32(3.0) - s * series
    return np.float32(4.0) * t * (one - s * series)


_OUTSIDE, _TOUCHED, _CENTRED, _WHOLE = 0, 1, 2, 3


@kernel
def view_block(
    coords: Int32, voxel_m: float, transform: Float64, fan: Float64, shape: Int64, views: Int32
) -> None:
    """Which pixels each voxel of a block covers.

    The half extents of a cube along the directions of range, elevation and azimuth are exact; a
    voxel covers the pixels of the rectangle they span.

    Args:
        coords: (3,) block index.
        voxel_m: Edge length of a voxel.
        transform: ``world_from_sonar``, (4, 4).
        fan: See `fan_vector`.
        shape: Numbers of beams and bins.
        views: (5, 512), written: first and last beam, first and last bin, cut to the image, and
            whether the voxel is outside the fan, touches it, has its centre in view, or has that
            and all its range extent too.
    """
    # single precision throughout: twice the voxels a vector instruction, to 0.0001 of a pixel
    f = np.float32
    zero, one, tiny = f(0.0), f(1.0), f(1e-12)
    half_azimuth, sin_elevation, range_min_m = f(fan[0]), f(math.sin(fan[1])), f(fan[2])
    beams_per_rad, bins_per_m = f(1.0 / fan[3]), f(1.0 / fan[4])
    beams, bins = f(shape[0]), f(shape[1])
    step, half = f(voxel_m), f(0.5 * voxel_m)
    r00, r01, r02 = f(transform[0, 0]), f(transform[0, 1]), f(transform[0, 2])
    r10, r11, r12 = f(transform[1, 0]), f(transform[1, 1]), f(transform[1, 2])
    r20, r21, r22 = f(transform[2, 0]), f(transform[2, 1]), f(transform[2, 2])
    x0 = f((coords[0] * BLOCK + 0.5) * voxel_m - transform[0, 3])
    y0 = f((coords[1] * BLOCK + 0.5) * voxel_m - transform[1, 3])
    z0 = f((coords[2] * BLOCK + 0.5) * voxel_m - transform[2, 3])
    beam0s, beam1s, cell0s, cell1s, sights = views[0], views[1], views[2], views[3], views[4]
    for k in range(VOXELS_PER_BLOCK):  # one flat loop without branches, so that it vectorises
        dx = x0 + f(k >> 6) * step
        dy = y0 + f((k >> 3) & 7) * step
        dz = z0 + f(k & 7) * step
        x = r00 * dx + r10 * dy + r20 * dz
        y = r01 * dx + r11 * dy + r21 * dz
        z = r02 * dx + r12 * dy + r22 * dz
        square = x * x + y * y
        flat = math.sqrt(square) + tiny
        distance = math.sqrt(square + z * z) + tiny
        per_flat, per_distance = one / flat, one / distance  # divisions cost most here
        deep = half * (abs(dx) + abs(dy) + abs(dz)) * per_distance
        high = (
            abs(r02 * square - (r00 * x + r01 * y) * z)
            + abs(r12 * square - (r10 * x + r11 * y) * z)
            + abs(r22 * square - (r20 * x + r21 * y) * z)
        )
        high = half * high * per_flat * per_distance
        wide = abs(r01 * x - r00 * y) + abs(r11 * x - r10 * y) + abs(r21 * x - r20 * y)
        spread = half * wide * per_flat * per_flat * beams_per_rad
        column = (half_azimuth - _angle_ahead(y, x, flat)) * beams_per_rad
        row = (distance - range_min_m) * bins_per_m
        depth = deep * bins_per_m
        level = distance * sin_elevation
        touched = (
            (x > zero)
            & (flat >= half)
            & (abs(z) <= level + high)
            & (column + spread >= zero)
            & (column - spread < beams)
            & (row + depth >= zero)
            & (row - depth < bins)
        )
        centred = (
            touched
            & (abs(z) <= level)
            & (column >= zero)
            & (column < beams)
            & (row >= zero)
            & (row <= bins)
        )
        whole = centred & (row - depth >= zero) & (row + depth < bins)
        beam0s[k] = np.int32(min(max(column - spread, zero), beams))
        beam1s[k] = np.int32(min(max(column + spread, zero), beams - one))
        cell0s[k] = np.int32(min(max(row - depth, zero), bins))
        cell1s[k] = np.int32(min(max(row + depth, zero), bins - one))
        sights[k] = np.int32(touched) + np.int32(centred) + np.int32(whole)


_MIXED, _FREE, _SHADOWED = 0, 1, 2
_MARGIN = 0.02
"""Pixels; what single precision may be off, and more."""


@kernel
def _fate(
    coords: Int32, voxel_m: float, transform: Float64, fan: Float64, echoes: Int32, first: Int32
) -> int:
    """Whether all pixels that a block covers are free, or all are silent and in shadow.

    They lie within the pixels of the sphere around the block: most blocks are told so, without a
    look at each of their voxels' pixels.
    """
    half, block_m = 0.5 * voxel_m, BLOCK * voxel_m
    dx = (coords[0] + 0.5) * block_m - transform[0, 3]
    dy = (coords[1] + 0.5) * block_m - transform[1, 3]
    dz = (coords[2] + 0.5) * block_m - transform[2, 3]
    x = transform[0, 0] * dx + transform[1, 0] * dy + transform[2, 0] * dz
    y = transform[0, 1] * dx + transform[1, 1] * dy + transform[2, 1] * dz
    corner = math.sqrt(3.0) * half
    inner = (BLOCK - 1) * corner  # from the middle to the farthest voxel's
    flat, distance = math.hypot(x, y), math.sqrt(dx * dx + dy * dy + dz * dz)
    if flat <= 2.0 * (inner + corner):
        return _MIXED
    beams, bins = first.shape[0], echoes.shape[1] - 1
    spread = (math.asin(inner / flat) + corner / (flat - inner)) / fan[3] + _MARGIN
    column = (fan[0] - math.atan2(y, x)) / fan[3]
    depth = (inner + corner) / fan[4] + _MARGIN
    row = (distance - fan[2]) / fan[4]
    beam0, beam1 = max(int(column - spread), 0), min(int(column + spread), beams - 1)
    cell0, cell1 = max(int(row - depth), 0), min(int(row + depth), bins - 1)
    free, shadowed = True, cell0 <= cell1
    for beam in range(beam0, beam1 + 1):
        free &= first[beam] > cell1
        shadowed &= first[beam] <= cell0 and echoes[beam, cell1 + 1] == echoes[beam, cell0]
    return _FREE if free else _SHADOWED if shadowed else _MIXED


@kernel
def _settled(cells: Float32, seen: Array, fate: int, least: float) -> bool:
    """Whether a block's fate changes nothing of it, as it is known to be free, or in view."""
    known = IN_VIEW | OBSERVED if fate == _FREE else IN_VIEW
    for k in range(VOXELS_PER_BLOCK):
        if seen[k] & known != known or (fate == _FREE and cells[k] > least):
            return False
    return True


@parallel_kernel
def _update(
    slots: Int64,
    blocks: Int32,
    all_log_odds: Float32,
    all_seen: Array,
    transform: Float64,
    fan: Float64,
    voxel_m: float,
    echoes: Int32,
    first: Int32,
    evidence: Float32,
) -> None:
    """Add evidence to the voxels of each block; a block is touched by one iteration only.

    A voxel is raised if any pixel it covers is occupied.  It is lowered only if its centre is in
    view and all pixels it covers are silent and lie before the first echo of their column.
    """
    shape = np.array([first.shape[0], echoes.shape[1] - 1])
    for block in prange(len(slots)):
        cells, seen = all_log_odds[slots[block]], all_seen[slots[block]]
        fate = _fate(blocks[block], voxel_m, transform, fan, echoes, first)
        if fate != _MIXED and _settled(cells, seen, fate, evidence[2]):
            continue
        views = np.empty((5, VOXELS_PER_BLOCK), np.int32)
        view_block(blocks[block], voxel_m, transform, fan, shape, views)
        beam0s, beam1s, cell0s, cell1s, sights = views[0], views[1], views[2], views[3], views[4]
        if fate != _MIXED:
            for k in range(VOXELS_PER_BLOCK):  # without branches, so that it vectorises
                silent = fate == _FREE and sights[k] == _WHOLE
                lower = max(cells[k] + evidence[0], evidence[2])
                cells[k] = lower if silent else cells[k]
                bits = IN_VIEW | OBSERVED if silent else IN_VIEW
                seen[k] |= bits if sights[k] >= _CENTRED else 0
            continue
        for k in range(VOXELS_PER_BLOCK):
            if sights[k] == _OUTSIDE:
                continue
            silent = sights[k] == _WHOLE
            occupied = False
            for beam in range(beam0s[k], beam1s[k] + 1):
                if cell1s[k] >= first[beam]:
                    silent = False
                    if echoes[beam, cell1s[k] + 1] > echoes[beam, cell0s[k]]:
                        occupied = True
                        break
            if occupied:
                cells[k] = min(cells[k] + evidence[1], evidence[3])
                seen[k] = IN_VIEW | OBSERVED
            elif silent:
                cells[k] = max(cells[k] + evidence[0], evidence[2])
                seen[k] = IN_VIEW | OBSERVED
            elif sights[k] >= _CENTRED:
                seen[k] |= IN_VIEW
