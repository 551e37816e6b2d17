"""Sonar messages as pings, told by the fields they have.

- ``ProjectedSonarImage`` (marine_acoustic_msgs): data range by range, as its consumers read it;
  beams along its directions, whatever plane of its frame they lie in (`directions`).
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

from insonify.frames import compose, pose_from_transform
from insonify.io.recordings.beams import EvenFan, even_fan
from insonify.io.recordings.ping360 import BEAM_DEG
from insonify.io.recordings.recording import HEIGHT_UNKNOWN, Reading
from insonify.io.recordings.ros.directions import BeamPlane, beam_plane
from insonify.io.recordings.ros.messages import DTYPES
from insonify.limits import MOST_PIXELS
from insonify.types import Array, Float64, Ping, Pose

ELEVATION_DEG = 20.0
"""Taken for a fan that no one tells the height of."""
_UPWARDS = math.sin(math.radians(60.0))
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
        reading: Reading,
        *,
        framed: bool = False,
        ours: bool = False,
    ) -> None:
        """For messages of a shape.

        Args:
            shape: A name that `sonar_shape` gives.
            mount: ``body_from_frame`` (4, 4) of the message's frame, where TF tells it for good.
            reading: Tells the mount and the height of the beams where nothing else does, and what
                overrules the messages.
            framed: Whether TF tells how the frame sits, for good or for each ping, to `sit`.
            ours: Whether insonify wrote them, so that frames are those of the definition.
        """
        self.doubts: list[str] = []
        self.axes = self.columns = ""
        self._shape, self.reading = shape, reading
        self._mount: Float64 | None = None
        self._ours = ours
        self._framed = framed
        self._fans: dict[Any, EvenFan] = {}
        self.sit(mount)

    def sit(self, mount: Float64 | None) -> None:
        """From now on the sonar's frame is there on the body, if that is known."""
        if mount is not None and (self._mount is None or (mount != self._mount).any()):
            self._mount = mount
            self._fans.clear()

    def ping(self, message: Any, time_s: float) -> Ping:
        """A message as a ping.

        Raises:
            ValueError: What it says of itself does not fit together.
        """
        pixels, fan = getattr(self, f"_{self._shape}")(message)
        return Ping(fan.image(pixels, self.reading.full_scale), fan.geometry, time_s)

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

    def raw(self, message: Any) -> Array:
        """Its pixels, of any shape and as they lie in it.

        Raises:
            ValueError: They are not as many as it says.
        """
        if self._shape == "ProjectedSonarImage":
            return self.pixels(message)
        if self._shape == "OculusPing":
            return _picture(message.ping)
        return np.asarray(message.intensities, np.uint8)

    def _ProjectedSonarImage(self, message: Any) -> tuple[Array, EvenFan]:  # noqa: N802
        pixels = self.pixels(message)
        vectors = np.array([[d.x, d.y, d.z] for d in message.beam_directions]).reshape(-1, 3)
        if len(vectors) != pixels.shape[1]:
            raise ValueError(f"it has {len(vectors)} directions for {pixels.shape[1]} beams")
        widths = message.ping_info.tx_beamwidths
        height = float(widths[0]) if len(widths) and 0.0 < widths[0] <= math.pi else 0.0
        ranges = np.asarray(message.ranges, np.float64)
        key = (vectors.tobytes(), ranges.tobytes(), height)
        if key not in self._fans:
            plane = beam_plane(vectors, by_definition=self._ours or self._framed)
            self.axes = plane.custom
            mount = self._seat(plane.frame_from_sonar, plane.frame_from_custom)
            self._note_axes(mount, plane)
            across = message.ping_info.rx_beamwidths
            width = float(across[0]) if len(across) else 0.0
            self._keep(key, plane.azimuths_rad, ranges, self._elevation(height), mount, width)
        return pixels, self._fans[key]

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
            self._keep(key, -bearings, ranges, self._elevation(0.0), self._seat())
        return pixels, self._fans[key]

    def _SonarEcho(self, message: Any) -> tuple[Array, EvenFan]:  # noqa: N802
        pixels = np.asarray(message.intensities, np.uint8).reshape(-1, 1)
        bins, angle = len(pixels), float(message.angle)
        key = (angle, bins, float(message.range))
        if key not in self._fans:
            if bins < 2 or not math.isfinite(angle):
                raise ValueError(f"it has {bins} samples at {angle} rad")
            width, height = np.radians(BEAM_DEG).tolist()
            ranges = (np.arange(bins, dtype=np.float64) + 0.5) * (float(message.range) / bins)
            angle = math.remainder(angle, math.tau)
            fan = even_fan(np.array([angle]), ranges, height, self._seat(), lone_beam_rad=width)
            self._fans[key] = fan
        return pixels, self._fans[key]

    def _seat(
        self, frame_from_sonar: Float64 | None = None, frame_from_custom: Float64 | None = None
    ) -> Pose:
        """The sonar on the body: as TF says, or as the user, whose axes are those of custom."""
        turned = np.eye(4) if frame_from_sonar is None else frame_from_sonar
        if self._mount is not None:
            return pose_from_transform(self._mount @ turned)
        if self._framed and self.reading.mount is not None:
            return self.reading.mount  # of the sonar itself: which way its beams run, TF says
        if frame_from_custom is not None:
            turned = frame_from_custom.T @ turned
        seat = self.reading.seat
        return seat if (turned == np.eye(4)).all() else compose(seat, pose_from_transform(turned))

    def _note_axes(self, mount: Pose, plane: BeamPlane) -> None:
        up = -math.sin(mount.pitch_rad)
        told = self._framed or self._ours or self.reading.beams is not None
        if not told and len(plane.azimuths_rad) > 1:
            self._doubt(
                f"the directions of its beams lie {plane.custom}, as is assumed, since nothing "
                "says how that frame sits; drivers differ, and if it is wrong the map is a mirror "
                "image (--beams says which way they run, `insonify check` finds out)"
            )
        elif self._mount is not None and up > _UPWARDS:
            self._doubt(
                f"by TF its beams look up by {math.degrees(math.asin(min(1.0, up))):.0f} degrees; "
                "if they do not, the frame of its pings is not the one that TF describes "
                "(--mount overrules it)"
            )

    def _doubt(self, words: str) -> None:
        if words not in self.doubts:
            self.doubts.append(words)

    def _keep(
        self,
        key: Any,
        azimuths: Float64,
        ranges: Float64,
        height: float,
        mount: Pose,
        width: float = 0.0,
    ) -> None:
        """Keep the fan of beams at azimuths in the order of the image, a lone one of a width."""
        if len(azimuths) == 1 and not 0.0 < width <= math.pi:
            raise ValueError("it has one beam, and its width (rx_beamwidths) is not told")
        port_first = bool(azimuths[0] >= azimuths[-1])
        mirrored = self.reading.mirrors(port_first)
        self.columns = self.reading.columns(port_first)
        order = np.argsort(-azimuths, kind="stable")
        fan = even_fan(
            azimuths[order], ranges, height, mount, lone_beam_rad=width, mirrored=mirrored
        )
        self._fans[key] = fan.reordered(order)

    def _elevation(self, told_rad: float) -> float:
        if told_rad > 0.0:
            return told_rad
        if self.reading.device is not None:
            return math.radians(self.reading.device.elevation_fov_deg)
        self._doubt(HEIGHT_UNKNOWN.format(ELEVATION_DEG))
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
