"""A folder of sonar images in polar form, with a pose file and the sonar's description beside.

Rows are ranges, the nearest first; columns are beams from port to starboard.  Images are taken in
the order of their names; a name that is a number with a decimal point is a time in seconds.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError
from insonify.io.recordings.beams import unit_pixels
from insonify.io.recordings.recording import (
    SIDE_UNKNOWN,
    Reading,
    Recording,
    RecordingWarning,
    scaled,
    with_poses,
)
from insonify.pictures import opened_picture
from insonify.sonar.devices import SonarDevice, named_device
from insonify.types import Array, FanGeometry, Ping, PosedPing

SUFFIXES = {".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm"}
POSE_FILES = ("poses.csv", "poses.txt", "poses.tum")
DEVICE_FILE = "sonar.toml"


def read_images(path: Path, reading: Reading) -> Recording:
    """Open a folder of images.

    Raises:
        RecordingError: There are no images, or nothing says what sonar made them.
    """
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise RecordingError(
            f"{path}: no images in this folder (PNG, TIFF, PGM, BMP, JPEG), and no bag"
        )
    device = _device(path, reading)
    first = _pixels(files[0])
    geometry = _geometry(device, first, reading)
    times = _times(files)
    mirrored = reading.mirrors(port_first=True)
    reading, doubts = scaled(reading, first.dtype, lambda: _largest(files))
    if reading.beams is None:
        doubts.append(SIDE_UNKNOWN.format("port"))

    def read() -> Iterator[PosedPing]:
        for number, file in enumerate(files):
            try:
                pixels = _pixels(file)
            except RecordingError as err:
                warnings.warn(f"{err}; it is left out", RecordingWarning, stacklevel=2)
                continue
            fan = geometry if pixels.shape == first.shape else _geometry(device, pixels, reading)
            time_s = float(number) if times is None else times[number]
            ordered = pixels[:, ::-1] if mirrored else pixels
            yield PosedPing(Ping(unit_pixels(ordered, reading.full_scale), fan, time_s))

    facts = {
        "device": device.name,
        "pixels": str(first.dtype),
        "columns": reading.columns(port_first=True),
        "poses": "none",
        "doubts": doubts,
    }
    count = len(files)
    recording = Recording(path, "folder of images", count, times is not None, facts, read)
    beside = next((path / name for name in POSE_FILES if (path / name).is_file()), None)
    return recording if reading.poses is not None else with_poses(recording, reading, beside)


def _device(path: Path, reading: Reading) -> SonarDevice:
    if reading.device is not None:
        return reading.device
    if not (path / DEVICE_FILE).is_file():
        raise RecordingError(
            f"{path}: nothing says what sonar made these images; put a {DEVICE_FILE} into the "
            "folder, or name the sonar (--sonar)"
        )
    return named_device(str(path / DEVICE_FILE))


def _geometry(device: SonarDevice, pixels: Array, reading: Reading) -> FanGeometry:
    """The device's fan with as many bins and beams as the image has."""
    bins, beams = pixels.shape
    fan = device.model_copy(update={"bins": bins, "beams": beams}).geometry
    return fan if reading.mount is None else replace(fan, mount=reading.mount)


def _largest(files: list[Path]) -> int:
    """The largest pixel of all images that can be read."""
    most = 0
    for file in files:
        with suppress(RecordingError):
            most = max(most, int(_pixels(file).max()))
    return most


def _times(files: list[Path]) -> list[float] | None:
    """Times in seconds, if all names are numbers with a decimal point, in order."""
    try:
        times = [float(file.stem) for file in files if "." in file.stem]
    except ValueError:
        return None
    ordered = all(a <= b for a, b in pairwise(times))
    return times if len(times) == len(files) and ordered and np.isfinite(times).all() else None


def _pixels(file: Path) -> Array:
    with opened_picture(file, "an image", RecordingError) as image:
        if image.mode in {"L", "I", "I;16", "I;16B", "F"}:
            return np.array(image)
        if image.mode == "1":
            return np.array(image.convert("L"))
        colours = np.array(image.convert("RGB"))
        if image.mode in {"CMYK", "YCbCr", "HSV"} or np.ptp(colours, axis=2).any():
            raise RecordingError(
                f"{file}: a picture in colours ({image.mode}), which do not say how loud an echo "
                "was; export it in grey, of 8 or 16 bits"
            )
        return np.ascontiguousarray(colours[..., 0])
