"""Which pixels of a sonar image a voxel covers, as the papers' update has it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from insonify.mapping.bayes import view_block
from insonify.mapping.fan import fan_vector
from insonify.mapping.store import BLOCK, VOXELS_PER_BLOCK, cell_of
from insonify.types import FanGeometry, Float64

_CENTRED, _WHOLE = 2, 3


@dataclass(frozen=True, slots=True)
class Pixels:
    """A voxel in a sonar image.

    Attributes:
        beams: First and last that it covers, from port.
        bins: First and last that it covers.
        range_m: Of its centre.
        azimuth_rad: Of its centre, positive to port.
        elevation_rad: Of its centre; the image does not tell it.
        centred: Whether its centre is in view.
        whole: Whether all of its ranges are in view as well.
    """

    beams: tuple[int, int]
    bins: tuple[int, int]
    range_m: float
    azimuth_rad: float
    elevation_rad: float
    centred: bool
    whole: bool


def pixels_of(
    voxel: tuple[int, int, int], voxel_m: float, transform: Float64, geometry: FanGeometry
) -> Pixels | None:
    """The pixels that a voxel covers; None if it is outside the fan.

    Args:
        voxel: Its index.
        voxel_m: Its edge length.
        transform: ``world_from_sonar``, (4, 4).
        geometry: The sonar.
    """
    index = np.array(voxel)
    away = transform[:3, :3].T @ ((index + 0.5) * voxel_m - transform[:3, 3])
    range_m = float(np.linalg.norm(away))
    if range_m > geometry.range_max_m + voxel_m:  # most pings of a long dive
        return None
    views = np.empty((5, VOXELS_PER_BLOCK), np.int32)
    shape = np.array([geometry.beams, geometry.bins])
    block = (index // BLOCK).astype(np.int32)
    view_block(block, voxel_m, transform, fan_vector(geometry), shape, views)
    beam0, beam1, bin0, bin1, sight = (int(value) for value in views[:, cell_of(index)])
    if not sight:
        return None
    return Pixels(
        beams=(min(beam0, beam1), beam1),
        bins=(min(bin0, bin1), bin1),
        range_m=range_m,
        azimuth_rad=math.atan2(away[1], away[0]),
        elevation_rad=math.asin(max(-1.0, min(1.0, away[2] / max(range_m, 1e-9)))),
        centred=sight >= _CENTRED,
        whole=sight >= _WHOLE,
    )
