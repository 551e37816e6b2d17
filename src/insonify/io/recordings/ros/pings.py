"""Sonar messages as pings, told by the fields they have.

- ``ProjectedSonarImage`` (marine_acoustic_msgs): data range by range, as its consumers read it;
  beams in the y-z plane of its frame, z forward, x up.
- ``OculusPing`` (sonar_oculus and its relatives): an image of ranges by beams, nearest first, port
  first; bearings to starboard, in hundredths of a degree if whole numbers, else in radians.
- ``SonarEcho`` (ping360_sonar): one beam at an angle, positive to port, over a range in metres.

The frames of the last two are taken as ours: x forward, y left, z up (REP 103).
"""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
from PIL import Image

from insonify.frames import pose_from_transform
from insonify.io.recordings.beams import EvenFan, even_fan
from insonify.io.recordings.recording import MOST_PIXELS
from insonify.io.recordings.ros.messages import DTYPES, IMAGE_FROM_SONAR
from insonify.sonar.devices import SonarDevice
from insonify.types import Array, Float64, Ping, Pose

PING360_BEAM_DEG = (2.0, 25.0)
"""Width and height of the Ping360's beam (Blue Robotics)."""
ELEVATION_DEG = 20.0
"""Taken for a fan that no one tells the height of."""
_SHAPES = {
    "ProjectedSonarImage": {"beam_directions", "ranges", "image", "ping_info"},
    "OculusPing": {"ping", "bearings", "range_resolution", "num_ranges"},
    "SonarEcho": {"angle", "range", "intensities"},
}
_GREY = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2", "32FC1": "f4"}


def sonar_shape(kind: str, fields: set[str] | None) -> str | None:
    """Which of the three a message type is, by its name or its fields; None if none of them."""
    name = kind.rsplit("/", 1)[-1]
    for shape, needed in _SHAPES.items():
        if name.startswith(shape) or (fields is not None and needed <= fields):
            return shape
    return None


class PingDecoder:
    """Messages of one sonar as pings; a fan that comes again is not computed again."""

    def __init__(
        self,
        shape: str,
        mount: Float64 | None,
        device: SonarDevice | None,
        full_scale: float | None = None,
    ) -> None:
        """For messages of a shape.

        Args:
            shape: A name that `sonar_shape` gives.
            mount: ``body_from_frame`` (4, 4) of the message's frame, where TF tells it.
            device: Tells the mount and the height of the beams where nothing else does.
            full_scale: Of its pixels, if that is not their type's.
        """
        self.elevation_assumed = False
        self._shape, self._device, self._full_scale = shape, device, full_scale
        self._mount = Pose(0.0, 0.0, 0.0) if device is None else device.geometry.mount
        self._fans: dict[Any, EvenFan] = {}
        self.sit(mount)

    def sit(self, mount: Float64 | None) -> None:
        """From now on the sonar's frame is there on the body, if that is known."""
        if mount is None:
            return
        turned = mount @ IMAGE_FROM_SONAR if self._shape == "ProjectedSonarImage" else mount
        pose = pose_from_transform(turned)
        if pose != self._mount:
            self._mount = pose
            self._fans.clear()

    def ping(self, message: Any, time_s: float) -> Ping:
        """A message as a ping.

        Raises:
            ValueError: What it says of itself does not fit together.
        """
        pixels, fan = getattr(self, f"_{self._shape}")(message)
        return Ping(fan.image(pixels, self._full_scale), fan.geometry, time_s)

    def pixels(self, message: Any) -> Array:
        """The image of a message, (bins, beams), as it lies in it, scaled by nothing.

        Raises:
            ValueError: Its size is not that of its ranges and beams.
        """
        image = message.image
        beams, bins = int(image.beam_count), len(message.ranges)
        if not 0 <= image.dtype < len(DTYPES):
            raise ValueError(f"its pixels are of the unknown type {image.dtype}")
        kind = np.dtype((">" if image.is_bigendian else "<") + DTYPES[image.dtype])
        if not 0 < beams * bins <= MOST_PIXELS or len(image.data) != beams * bins * kind.itemsize:
            raise ValueError(
                f"its {len(image.data)} bytes are not {bins} ranges x {beams} beams of {kind}"
            )
        data = np.asarray(image.data, np.uint8).view(kind).reshape(bins, beams)
        return data.astype(kind.newbyteorder("="))

    def _ProjectedSonarImage(self, message: Any) -> tuple[Array, EvenFan]:  # noqa: N802
        pixels = self.pixels(message)
        vectors = np.array([[d.x, d.y, d.z] for d in message.beam_directions]).reshape(-1, 3)
        if len(vectors) != pixels.shape[1]:
            raise ValueError(f"it has {len(vectors)} directions for {pixels.shape[1]} beams")
        widths = message.ping_info.tx_beamwidths
        height = float(widths[0]) if len(widths) and 0.0 < widths[0] <= math.pi else 0.0
        ranges = np.asarray(message.ranges, np.float64)
        order = np.argsort(np.arctan2(vectors[:, 1], vectors[:, 2]), kind="stable")
        key = (vectors.tobytes(), ranges.tobytes(), height)
        if key not in self._fans:
            lengths = np.linalg.norm(vectors, axis=1)
            if not (np.isfinite(vectors).all() and (lengths > 1e-6).all()):
                raise ValueError("a beam has no direction")
            if (abs(vectors[:, 0]) > 0.1 * lengths).any():
                raise ValueError("its beams leave the y-z plane")
            azimuths = np.arctan2(-vectors[:, 1], vectors[:, 2])[order]
            self._keep(key, azimuths, ranges, self._elevation(height), self._mount)
        return pixels[:, order], self._fans[key]

    def _OculusPing(self, message: Any) -> tuple[Array, EvenFan]:  # noqa: N802
        pixels = _picture(message.ping)
        given = np.asarray(message.bearings)
        scale = math.radians(0.01) if given.dtype.kind in "iu" else 1.0
        bearings = given.astype(np.float64) * scale
        bins, beams = int(message.num_ranges), len(bearings)
        if pixels.shape != (bins, beams):
            raise ValueError(f"its picture is {pixels.shape}, not {bins} ranges x {beams} beams")
        step = float(message.range_resolution)
        key = (bearings.tobytes(), bins, step)
        if key not in self._fans:
            ranges = (np.arange(bins, dtype=np.float64) + 0.5) * step
            self._keep(key, -bearings, ranges, self._elevation(0.0), self._mount)
        return pixels, self._fans[key]

    def _SonarEcho(self, message: Any) -> tuple[Array, EvenFan]:  # noqa: N802
        pixels = np.asarray(message.intensities, np.uint8).reshape(-1, 1)
        bins, angle = len(pixels), float(message.angle)
        key = (angle, bins, float(message.range))
        if key not in self._fans:
            if bins < 2 or not math.isfinite(angle):
                raise ValueError(f"it has {bins} samples at {angle} rad")
            width, height = np.radians(PING360_BEAM_DEG).tolist()
            ranges = (np.arange(bins, dtype=np.float64) + 0.5) * (float(message.range) / bins)
            angle = math.remainder(angle, math.tau)
            fan = even_fan(np.array([angle]), ranges, height, self._mount, lone_beam_rad=width)
            self._fans[key] = fan
        return pixels, self._fans[key]

    def _keep(
        self, key: Any, azimuths: Float64, ranges: Float64, height: float, mount: Pose
    ) -> None:
        self._fans[key] = even_fan(azimuths, ranges, height, mount)

    def _elevation(self, told_rad: float) -> float:
        if told_rad > 0.0:
            return told_rad
        if self._device is not None:
            return math.radians(self._device.elevation_fov_deg)
        self.elevation_assumed = True
        return math.radians(ELEVATION_DEG)


def _picture(image: Any) -> Array:
    """Pixels of a sensor_msgs/Image or CompressedImage, one channel."""
    if hasattr(image, "format"):
        with Image.open(io.BytesIO(bytes(image.data))) as picture:
            if picture.size[0] * picture.size[1] > MOST_PIXELS:
                raise ValueError(f"its picture of {picture.size} is too large")
            return np.array(picture.convert("L"))
    kind = _GREY.get(image.encoding)
    if kind is None:
        raise ValueError(f"its picture is encoded as {image.encoding!r}, not grey")
    order = np.dtype((">" if image.is_bigendian else "<") + kind)
    rows = np.asarray(image.data, np.uint8).reshape(int(image.height), int(image.step))
    used = rows[:, : int(image.width) * order.itemsize]
    return np.ascontiguousarray(used).view(order).astype(order.newbyteorder("="))
