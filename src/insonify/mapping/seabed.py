"""The seabed's height, as the pings themselves tell it.

In each beam, the lower edge of the fan meets the seabed first.  Where an object stands in the way
it is heard sooner, and the same reckoning gives a point above the seabed: so the seabed is the
lower envelope of such points.  No scene is asked, and where there is no seabed none is found.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from insonify.frames import directions_from_angles
from insonify.jit import kernel
from insonify.types import Array, FanGeometry, Float32, Float64, Int64

CELL_M = 0.8
_STEP_M = 0.02
_STEPS = 160
_ABOVE = 40
"""Steps of a cell's histogram below its first point."""
_LOW = 0.25
"""Quantile of a cell's points that is taken for the seabed."""
_LEAST = 4
"""Points that a cell needs."""
_CELLS = 12
"""Cells that a seabed needs."""
_RUN = 5
"""Bins in which a seabed's echo is unbroken, but for one."""
_SLOPE = 0.1
"""Standard deviation of slopes that are to be expected."""
_ROUGH_M = 0.3
"""Residuals of so much and more are no seabed's."""
_NEAR_M = 1.6
"""How far residuals reach."""
_STEEPEST = -0.05
"""Vertical part of the lower edge's direction at which a seabed may still be met."""
_AGREEING = 0.5
"""Share of the cells that must lie near a smooth surface for it to be a seabed."""


class SeabedHeights:
    """A robust height field on a coarse grid, which grows where the sonar looks."""

    def __init__(self) -> None:
        """Nothing known."""
        self._cells: dict[tuple[int, int], int] = {}
        self._coords = np.zeros((64, 2), np.int64)
        self._base_m = np.zeros(64)
        self._counts = np.zeros((64, _STEPS), np.uint32)

    def hear(self, image: Float32, lit: float, transform: Float64, geometry: FanGeometry) -> None:
        """Take in a ping.

        Args:
            image: (bins, beams).
            lit: Pixels over it are echoes.
            transform: ``world_from_sonar``, (4, 4).
            geometry: The sonar's.
        """
        azimuths = geometry.beam_azimuths_rad
        lower = np.full(len(azimuths), -geometry.elevation_fov_rad / 2)
        directions = directions_from_angles(azimuths, lower) @ transform[:3, :3].T
        first = _first_runs(image, np.float32(lit))
        heard = (first >= 0) & (directions[:, 2] < _STEEPEST)
        ranges = geometry.range_min_m + (first[heard] + 0.5) * geometry.bin_m
        points = transform[:3, 3] + ranges[:, None] * directions[heard]
        cells = np.floor(points[:, :2] / CELL_M).astype(np.int64)
        slots = np.array(
            [
                self._slot(x, y, z)
                for (x, y), z in zip(cells.tolist(), points[:, 2].tolist(), strict=True)
            ],
            np.int64,
        )
        step = np.floor((points[:, 2] - self._base_m[slots]) / _STEP_M).astype(np.int64)
        for slot, under in zip(slots[step < 0].tolist(), points[step < 0, 2].tolist(), strict=True):
            self._lower(slot, under)
        step = np.floor((points[:, 2] - self._base_m[slots]) / _STEP_M).astype(np.int64)
        inside = (step >= 0) & (step < _STEPS)
        np.add.at(self._counts, (slots[inside], step[inside]), 1)

    def heights(self, x_m: Array, y_m: Array) -> tuple[Float64, Float64] | None:
        """Heights at points of a grid (nx,) by (ny,), world frame; None while no seabed is known.

        Returns:
            (nx, ny) metres, and by how many points near by.
        """
        known = self._near(x_m, y_m)
        if known is None:
            return None
        places, heights, weights = known
        middle = places.mean(axis=0)
        plane = _plane(places - middle, heights, weights)
        if plane is None:
            return None
        residuals = heights - _on(plane, places - middle)
        good = np.abs(residuals) < _ROUGH_M
        grid = np.stack(np.meshgrid(x_m, y_m, indexing="ij"), axis=-1)
        # what departs from the plane is smooth: every other point is enough
        few = np.ascontiguousarray(grid[::2, ::2]).reshape(-1, 2)
        away = ((few[:, None, :] - places[good][None, :, :]) ** 2).sum(axis=2)
        near = np.exp(-0.5 * away / (0.5 * _NEAR_M) ** 2) * np.minimum(weights[good], 20.0)
        points = near.sum(axis=1)
        shift = near @ residuals[good] / (points + 1.0)
        size = grid[::2, ::2].shape[:2]
        shifts, numbers = (
            values.reshape(size).repeat(2, axis=0).repeat(2, axis=1)[: len(x_m), : len(y_m)]
            for values in (shift, points)
        )
        return _on(plane, grid - middle) + shifts, numbers

    def save(self) -> dict[str, Array]:
        """All that is known."""
        count = len(self._cells)
        return {
            "seabed_cells": self._coords[:count].copy(),
            "seabed_base_m": self._base_m[:count].copy(),
            "seabed_counts": self._counts[:count].copy(),
        }

    def load(self, arrays: Mapping[str, Array]) -> None:
        """Go on from what `save` gave."""
        self._coords = arrays["seabed_cells"].copy()
        self._base_m = arrays["seabed_base_m"].copy()
        self._counts = arrays["seabed_counts"].copy()
        self._cells = {(int(x), int(y)): slot for slot, (x, y) in enumerate(self._coords)}

    def _near(self, x_m: Array, y_m: Array) -> tuple[Float64, Float64, Float64] | None:
        """Cells around a grid: their middles (N, 2), heights (N,) and numbers of points (N,)."""
        coords = self._coords[: len(self._cells)]
        middles = (coords + 0.5) * CELL_M
        low, high = np.array([x_m[0], y_m[0]]) - 4.0, np.array([x_m[-1], y_m[-1]]) + 4.0
        near = ((middles >= low) & (middles <= high)).all(axis=1)
        counts = self._counts[: len(self._cells)][near].astype(np.float64)
        total = counts.sum(axis=1)
        enough = total >= _LEAST
        if np.count_nonzero(enough) < _CELLS:
            return None
        counts, total = counts[enough], total[enough]
        step = (np.cumsum(counts, axis=1) >= _LOW * total[:, None]).argmax(axis=1)
        heights = self._base_m[: len(self._cells)][near][enough] + (step + 0.5) * _STEP_M
        return middles[near][enough], heights, total

    def _slot(self, x: int, y: int, z_m: float) -> int:
        slot = self._cells.get((x, y))
        if slot is None:
            slot = self._cells[x, y] = len(self._cells)
            if slot >= len(self._coords):
                for name in ("_coords", "_base_m", "_counts"):
                    old = getattr(self, name)
                    more = np.zeros((max(64, len(old)), *old.shape[1:]), old.dtype)
                    setattr(self, name, np.concatenate([old, more]))
            self._coords[slot] = x, y
            self._base_m[slot] = z_m - _ABOVE * _STEP_M
        return slot

    def _lower(self, slot: int, z_m: float) -> None:
        """Make room in a histogram for a point below it; the highest are forgotten."""
        if z_m >= self._base_m[slot]:
            return
        steps = math.ceil((self._base_m[slot] - z_m) / _STEP_M) + _ABOVE
        moved = np.zeros(_STEPS, np.uint32)
        if steps < _STEPS:
            moved[steps:] = self._counts[slot, : _STEPS - steps]
        self._counts[slot] = moved
        self._base_m[slot] -= steps * _STEP_M


@kernel
def _first_runs(image: Float32, lit: np.float32) -> Int64:
    """First bin of each beam's first unbroken echo; -1 if there is none before an unknown pixel."""
    bins, beams = image.shape
    first = np.full(beams, -1, np.int64)
    for beam in range(beams):
        for cell in range(bins - _RUN + 1):
            if not image[cell, beam] <= lit:
                count = 0
                for k in range(_RUN):
                    count += image[cell + k, beam] > lit
                if count >= _RUN - 1 and image[cell, beam] > lit:
                    first[beam] = cell
                    break
                if np.isnan(image[cell, beam]):
                    break
    return first


def _plane(places: Float64, heights: Float64, weights: Float64) -> Float64 | None:
    """A level or sloping plane under points, outliers and what stands on it left out.

    Args:
        places: (N, 2) about their mean.
        heights: (N,).
        weights: (N,) numbers of points.

    Returns:
        Height and two slopes; None if the points agree on none.
    """
    design = np.column_stack([np.ones(len(places)), places])
    prior = np.diag([1e-9, (0.1 / _SLOPE) ** 2, (0.1 / _SLOPE) ** 2])
    trust = np.minimum(weights, 20.0)
    plane = np.array([np.quantile(heights, 0.3), 0.0, 0.0])
    for _ in range(6):
        residuals = heights - design @ plane
        # what lies above may be an object, what lies below is hardly anything but seabed
        spread = np.where(residuals > 0.0, 0.15, 0.4)
        scale = trust / (1.0 + (residuals / spread) ** 2) ** 2
        plane = np.linalg.solve(
            design.T @ (scale[:, None] * design) + prior, design.T @ (scale * heights)
        )
    residuals = heights - design @ plane
    agreeing = trust[np.abs(residuals) < _ROUGH_M].sum() / trust.sum()
    return plane if agreeing >= _AGREEING else None


def _on(plane: Float64, places: Float64) -> Float64:
    heights: Float64 = plane[0] + places @ plane[1:]
    return heights
