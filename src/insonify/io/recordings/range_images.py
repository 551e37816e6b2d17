"""Recordings of Water Linked's Sonar 3D-15 (``.sonar``): range images, read with wlsonar.

A range image tells, for each direction of a grid of azimuths and elevations, how far away the
strongest echo was, or that there was none.  Each of its columns is a fan of its own, upright: an
echo at its range, water before it, and nothing known where no echo was kept, since that need not
mean that there is none.  Row 0 looks down; column 0 is the port side (wlsonar's own conversion to
x, y, z).
"""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.extras import optional
from insonify.frames import compose
from insonify.io.recordings.recording import Reading, Recording, RecordingWarning, span
from insonify.types import Array, FanGeometry, Float32, Ping, Pose, PosedPing

STARTS = (b"RIP1", b"RIP2")
MOST_BYTES = 1 << 30
_BIN_M = 0.02
_MOST_BINS, _MOST_SIDE = 8192, 2048
_QUARTER = Pose(0.0, 0.0, 0.0, roll_rad=math.pi / 2)
"""A fan on its side: its port side is up."""


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    """One range image: metres (rows, columns), 0 where nothing is known."""

    time_s: float
    distance_m: Array
    range_m: float
    across_rad: float
    high_rad: float
    sound_speed_mps: float


def read_range_images(path: Path, reading: Reading) -> Recording:
    """Open a recording of range images; each column of each is a ping.

    Raises:
        RecordingError: There is no whole range image in it.
        MissingExtraError: wlsonar is not installed.
    """
    if path.stat().st_size > MOST_BYTES:
        raise RecordingError(f"{path}: larger than 1 GiB; split it")
    if reading.beams is not None:
        raise RecordingError(f"{path}: its columns are told by their directions, so not by --beams")
    images = list(_images(path))
    if not images:
        raise RecordingError(f"{path}: no whole range image of a Sonar 3D-15 in it")
    count = sum(image.distance_m.shape[1] for image in images)

    def read() -> Iterator[PosedPing]:
        for image in images:
            yield from map(PosedPing, _columns(image, reading.seat))

    facts = {
        "device": "Water Linked Sonar 3D-15",
        "range_images": len(images),
        "size": "{1} x {0} directions".format(*images[0].distance_m.shape),
        "azimuth_deg": round(math.degrees(images[0].across_rad), 3),
        "elevation_deg": round(math.degrees(images[0].high_rad), 3),
        "range_m": span([image.range_m for image in images]),
        "sound_speed_mps": span([image.sound_speed_mps for image in images]),
        "without_echo": f"{np.mean([(one.distance_m == 0.0).mean() for one in images]):.0%}",
        "poses": "none",
        "doubts": [],
    }
    return Recording(path, "range images (Water Linked)", count, True, facts, read)


def _images(path: Path) -> Iterator[_Image]:
    """The range images of a file; a warning says what was left out."""
    needed = ("waterlinked", "a Sonar 3D-15 recording (.sonar)")
    rip = optional("wlsonar.range_image_protocol", *needed)
    damage = (
        ValueError,
        OSError,
        struct.error,
        optional("google.protobuf.message", *needed).Error,
        optional("cramjam", *needed).DecompressionError,
    )
    lost, cut = 0, ""
    with path.open("rb") as file:
        while not cut:
            try:
                message = rip.unpack(file)
            except EOFError:
                break
            except rip.UnknownProtobufTypeError:
                continue
            except rip.CRCMismatchError:
                lost += 1
                continue
            except damage as err:
                cut = reason(err)
                break
            image = _image(message) if isinstance(message, rip.RangeImage) else None
            if image is not None:
                yield image
            elif isinstance(message, rip.RangeImage):
                lost += 1
    if lost or cut:
        warnings.warn(
            f"{path}: damaged or cut off; {lost} messages left out" + f" ({cut})" * bool(cut),
            RecordingWarning,
            stacklevel=4,
        )


def _image(message: Any) -> _Image | None:
    """A message as a range image, None if its figures make no sense."""
    shape = int(message.height), int(message.width)
    pixels = np.array(message.image_pixel_data, np.float64)
    figures = (
        message.range, message.fov_horizontal, message.fov_vertical, message.image_pixel_scale,
        message.speed_of_sound,
    )  # fmt: skip
    range_m, across, high, scale, speed = map(float, figures)
    sane = (
        min(shape) > 1
        and max(shape) <= _MOST_SIDE
        and len(pixels) == shape[0] * shape[1]
        and all(map(math.isfinite, figures))
        and 0.1 < range_m < 1000.0
        and 0.0 < across <= 180.0
        and 0.0 < high <= 170.0
        and 0.0 < scale < 1.0
    )
    if not sane:
        return None
    time_s = message.header.timestamp.ToNanoseconds() * 1e-9
    distance = pixels.reshape(shape) * scale
    return _Image(time_s, distance, range_m, math.radians(across), math.radians(high), speed)


def _columns(image: _Image, seat: Pose) -> Iterator[Ping]:
    """A range image's columns from port to starboard, each an upright fan."""
    rows, columns = image.distance_m.shape
    far = max(image.range_m, float(image.distance_m.max()) + _BIN_M)
    bins = min(_MOST_BINS, math.ceil(far / _BIN_M))
    step = image.across_rad / (columns - 1)
    for column in range(columns):
        yaw = image.across_rad / 2 - column * step
        turned = compose(Pose(0.0, 0.0, 0.0, yaw_rad=yaw), _QUARTER)
        fan = FanGeometry(
            azimuth_fov_rad=image.high_rad * rows / (rows - 1),
            elevation_fov_rad=step,
            beams=rows,
            bins=bins,
            range_min_m=0.0,
            range_max_m=far,
            mount=compose(seat, turned),
        )
        upwards = image.distance_m[::-1, column]  # row 0 looks down, beam 0 up
        yield Ping(_one_echo(upwards, fan), fan, image.time_s)


def _one_echo(distance_m: Array, fan: FanGeometry) -> Float32:
    """An image with an echo at each beam's distance; not a number where none is known."""
    pixels = np.zeros((fan.bins, fan.beams), np.float32)
    known = np.flatnonzero(distance_m > 0.0)
    bins = np.minimum((distance_m[known] / fan.bin_m).astype(int), fan.bins - 1)
    pixels[bins, known] = 1.0
    pixels[:, distance_m == 0.0] = np.nan
    return pixels
