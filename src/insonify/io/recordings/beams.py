"""Beams where the device points them, and the even fan that maps are made with.

`FanGeometry` spaces beams and bins evenly and is symmetric.  A device whose beams are not is
resampled: the fan has as many beams as the device, spans the same angles, and each of its beams
takes the whole column of the device's beam in whose sector its centre lies, so that every pixel
stays one the device measured.  A fan that looks to one side is turned by its mount.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from insonify.frames import compose
from insonify.types import Array, FanGeometry, Float32, Float64, Int64, Pose

_ROUNDING = 1e-4
_CONVERTERS = (8, 10, 12, 14, 16, 24)
"""Bits of an echo in devices."""
EVEN = 0.02
"""Beams count as even if none is further from its even place than this share of a beam."""


@dataclass(frozen=True, slots=True, eq=False)
class EvenFan:
    """A fan geometry, and which of the device's rows and columns make it.

    ``beams`` and ``bins`` are None where the device's own are even already.
    """

    geometry: FanGeometry
    beams: Int64 | None
    bins: Int64 | None

    def reordered(self, order: Int64) -> EvenFan:
        """The same of an image whose columns must first be put in an order."""
        if (order == np.arange(len(order))).all():
            return self
        beams = order if self.beams is None else order[self.beams]
        return EvenFan(self.geometry, beams, self.bins)

    def image(self, pixels: Array, full_scale: float | None = None) -> Float32:
        """The device's image, (bins, beams), as an image of the even fan; see `unit_pixels`."""
        if self.beams is not None:
            pixels = pixels[:, self.beams]
        if self.bins is not None:
            pixels = pixels[self.bins]
        return unit_pixels(pixels, full_scale)


def even_fan(
    azimuths_rad: Float64,
    ranges_m: Float64,
    elevation_fov_rad: float,
    mount: Pose,
    *,
    lone_beam_rad: float = 0.0,
    mirrored: bool = False,
) -> EvenFan:
    """The even fan of a device.

    Args:
        azimuths_rad: (beams,) centres, port to starboard, so falling.
        ranges_m: (bins,) centres, rising.
        elevation_fov_rad: Height of all beams.
        mount: The sonar on the body.
        lone_beam_rad: Width of a beam that has no neighbours to tell it by.
        mirrored: Each beam looks as far to the other side.

    Raises:
        ValueError: The centres are not in order, or are no angles and ranges of a sonar.
    """
    if mirrored:
        azimuths_rad = -azimuths_rad[::-1]
    left, right, beams = _spread(-azimuths_rad, lone_beam_rad)
    left, right = -left, -right
    near, far, bins = _spread(ranges_m, 0.0)
    if not (0.0 < left - right <= np.pi + 1e-9 and max(abs(left), abs(right)) < 2 * np.pi):
        raise ValueError(f"the beams span {np.degrees(left - right):.4g} degrees")
    if not -1e-6 * far <= near < far < 1e5:
        raise ValueError(f"the ranges go from {near:.4g} to {far:.4g} m")
    if not 0.0 < elevation_fov_rad <= np.pi:
        raise ValueError(f"the beams are {np.degrees(elevation_fov_rad):.4g} degrees high")
    middle = 0.5 * (left + right)
    spare = EVEN * (left - right) / len(azimuths_rad) if beams is None else 1e-12
    if abs(middle) > spare:
        mount = compose(mount, Pose(0.0, 0.0, 0.0, yaw_rad=middle))
    geometry = FanGeometry(
        azimuth_fov_rad=left - right,
        elevation_fov_rad=elevation_fov_rad,
        beams=len(azimuths_rad),
        bins=len(ranges_m),
        range_min_m=max(0.0, near),
        range_max_m=far,
        mount=mount,
    )
    fan = EvenFan(geometry, beams, bins)
    return fan.reordered(np.arange(len(azimuths_rad))[::-1]) if mirrored else fan


def _spread(centres: Float64, lone: float) -> tuple[float, float, Int64 | None]:
    """Outer edges of rising centres, and for each even place the index of the centre it takes."""
    count = len(centres)
    if count == 0 or not np.isfinite(centres).all():
        raise ValueError("its beams or ranges are missing or not finite")
    if count == 1:
        width = lone or 2.0 * float(centres[0])
        return float(centres[0]) - width / 2, float(centres[0]) + width / 2, None
    steps = np.diff(centres)
    if (steps <= 0).any():
        raise ValueError("its beams or ranges are not in order")
    step = float(centres[-1] - centres[0]) / (count - 1)
    even = centres[0] + step * np.arange(count)
    if float(abs(centres - even).max()) <= EVEN * step:
        return float(centres[0]) - step / 2, float(centres[-1]) + step / 2, None
    first, last = float(centres[0] - steps[0] / 2), float(centres[-1] + steps[-1] / 2)
    places = first + (np.arange(count) + 0.5) * (last - first) / count
    return first, last, np.searchsorted(0.5 * (centres[1:] + centres[:-1]), places)


def bits_used(kind: np.dtype[Any], largest: int) -> int:
    """Of whole pixels up to ``largest``: of how many bits the device that made them likely is.

    Those of its type, or as many as converters have if even the largest leaves the others unused.
    """
    whole = kind.itemsize * 8 - (kind.kind == "i")
    return next((bits for bits in _CONVERTERS if 0 < largest < 1 << bits and bits < whole), whole)


class PixelError(ValueError):
    """Pixels that cannot be meant as they stand."""


def unit_pixels(
    pixels: Array, full_scale: float | None = None, *, unknown: bool = False
) -> Float32:
    """Pixels as float32 in [0, 1].

    Args:
        pixels: Whole numbers or floating ones.
        full_scale: The value that means 1; by default the largest of a whole number's type, and 1.
        unknown: Whether a pixel that is not a number means that nothing is known of it.

    Raises:
        PixelError: A pixel is not a number, below 0, or above the full scale.
    """
    whole = pixels.dtype.kind in "ui"
    if pixels.dtype.kind not in "uif":
        raise PixelError(f"its pixels are of type {pixels.dtype}, which is none of numbers")
    scale = full_scale or (float(np.iinfo(pixels.dtype).max) if whole else 1.0)
    scaled = pixels.astype(np.float32) / np.float32(scale)
    if not (np.isfinite(scaled) | (np.isnan(scaled) & unknown)).all():
        raise PixelError("a pixel is not a number")
    low, high = (float(f.reduce(scaled, axis=None, initial=0.0)) for f in (np.fmin, np.fmax))
    if low < -_ROUNDING:
        raise PixelError(
            f"its pixels go down to {low * scale:.6g}, and an echo is never below 0; if they are "
            "decibels, write amplitudes"
        )
    if high > 1.0 + _ROUNDING:
        raise PixelError(
            f"its pixels go up to {high * scale:.6g}, above the full scale of {scale:g}; say which "
            "value means the loudest (--scale 255, for one)"
        )
    return np.ascontiguousarray(np.clip(scaled, 0.0, 1.0))
