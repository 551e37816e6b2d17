"""Frozen records that every room of the house may use.

Units are in the names.  World frame: ENU; body and sonar frames: forward, left, up (REP 103).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from insonify.display import Pictured
from insonify.errors import GeometryError
from insonify.extras import optional
from insonify.limits import FARTHEST_POSE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import DataArray

Array = npt.NDArray[Any]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
UInt32 = npt.NDArray[np.uint32]
UInt64 = npt.NDArray[np.uint64]
Int64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]


POSE = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
"""What `Pose.numbers` are, as tables and stores name them."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a body is: the state vector X of Park et al. 2025, section 2.1, in the world frame.

    Rotations are intrinsic yaw, pitch, roll (z, y, x); a positive pitch points the nose down.

    Raises:
        GeometryError: A number is not finite, or beyond `insonify.limits.FARTHEST_POSE`.
    """

    x_m: float
    y_m: float
    z_m: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        numbers = self.numbers
        if not all(map(math.isfinite, numbers)):
            raise GeometryError(f"a pose needs six finite numbers, not {numbers}: check its source")
        if max(map(abs, numbers)) > FARTHEST_POSE:
            raise GeometryError(
                f"a pose of {numbers} is nowhere: no number may be beyond {FARTHEST_POSE:g}; check "
                "its source"
            )

    @property
    def numbers(self) -> tuple[float, float, float, float, float, float]:
        """x, y, z in metres; roll, pitch, yaw in radians."""
        return (self.x_m, self.y_m, self.z_m, self.roll_rad, self.pitch_rad, self.yaw_rad)

    @property
    def position_m(self) -> tuple[float, float, float]:
        """The position alone."""
        return (self.x_m, self.y_m, self.z_m)

    @property
    def std(self) -> tuple[float, float]:
        """How far it may be off: standard deviations of position (m) and attitude (rad)."""
        return (0.0, 0.0)

    def moved(self, by_m: Sequence[float]) -> Pose:
        """The pose moved by a vector of the world."""
        x, y, z = (c + shift for c, shift in zip(self.position_m, by_m, strict=True))
        return replace(self, x_m=x, y_m=y, z_m=z)

    def relative_to(self, origin_m: Sequence[float]) -> Pose:
        """The pose as it is told from an origin."""
        return self.moved([-c for c in origin_m])


@dataclass(frozen=True, slots=True)
class EstimatedPose(Pose):
    """A pose as navigation tells it, with how far it may be off.

    Attributes:
        position_std_m: Standard deviation of the position, in the direction that is known least.
        attitude_std_rad: The same of the attitude.
    """

    position_std_m: float = 0.0
    attitude_std_rad: float = 0.0

    @property
    def std(self) -> tuple[float, float]:
        """As of any pose."""
        return (self.position_std_m, self.attitude_std_rad)


def estimated(pose: Pose, std: Iterable[float]) -> Pose:
    """A pose with how far it may be off, see `Pose.std`; the pose itself where that is 0."""
    position_std_m, attitude_std_rad = map(float, std)
    if not (position_std_m or attitude_std_rad):
        return pose
    return EstimatedPose(*pose.numbers, position_std_m, attitude_std_rad)


@dataclass(frozen=True, slots=True)
class FanGeometry:
    """What a 2D imaging sonar's pixels mean: beams over azimuth, bins over range.

    Beams are reported from port to starboard: beam 0 looks at the largest (leftmost) azimuth.
    Every beam spans the whole elevation field of view; that is the information the image loses.
    ``mount`` is the sonar's place on the body, ``body_from_sonar``; a pitch there tilts it down.
    """

    azimuth_fov_rad: float
    elevation_fov_rad: float
    beams: int
    bins: int
    range_min_m: float
    range_max_m: float
    mount: Pose = Pose(0.0, 0.0, 0.0)

    @property
    def tilt_rad(self) -> float:
        """How far the sonar's axis is tilted down from the body's."""
        return self.mount.pitch_rad

    @property
    def bin_m(self) -> float:
        """Range extent of one bin."""
        return (self.range_max_m - self.range_min_m) / self.bins

    @property
    def beam_rad(self) -> float:
        """Azimuth extent of one beam."""
        return self.azimuth_fov_rad / self.beams

    @property
    def beam_azimuths_rad(self) -> Float64:
        """Centre azimuth of each beam, (beams,), port to starboard."""
        beams = np.arange(self.beams, dtype=np.float64)
        return self.azimuth_fov_rad / 2 - (beams + 0.5) * self.beam_rad

    @property
    def bin_ranges_m(self) -> Float64:
        """Centre range of each bin, (bins,)."""
        bins = np.arange(self.bins, dtype=np.float64)
        return self.range_min_m + (bins + 0.5) * self.bin_m


@dataclass(frozen=True, slots=True, eq=False)
class Ping(Pictured):
    """One sonar image: ``(bins, beams) float32`` in [0, 1], and what its pixels mean.

    A pixel that is not a number is one of which nothing is known.

    ``time_s`` is when its sound was sent; ``head_rad`` how far to the left of its base's ahead a
    head that turns looked.
    """

    image: Float32
    geometry: FanGeometry
    time_s: float = 0.0
    head_rad: float = 0.0

    def plot(self, axes: Axes | None = None, *, power: float = 0.6) -> Axes:
        """Draw the image in fan view: ahead is up, port is left.

        Args:
            axes: Where; by default those of a new figure, which notebooks show.
            power: Values are shown to this power; below 1 brighter than they are.

        Returns:
            The axes, in metres.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        return self._plotted(axes, power=power)

    def to_xarray(self) -> DataArray:
        """The image over ``bin`` and ``beam``, with ``bin_range_m`` and ``azimuth_rad`` (to port).

        The rest of the geometry, ``time_s`` and ``head_rad`` are attributes.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        xarray = optional("xarray", "datasets", "to_xarray")
        fan, mount = self.geometry, self.geometry.mount
        about = {
            "long_name": "echo intensity",
            "units": "1",
            "azimuth_fov_rad": fan.azimuth_fov_rad,
            "elevation_fov_rad": fan.elevation_fov_rad,
            "range_min_m": fan.range_min_m,
            "range_max_m": fan.range_max_m,
            "mount_x_y_z_roll_pitch_yaw": list(mount.numbers),
            "time_s": self.time_s,
            "head_rad": self.head_rad,
        }
        ranges = ("bin", fan.bin_ranges_m, {"long_name": "centre range of the bin", "units": "m"})
        azimuths = (
            "beam",
            fan.beam_azimuths_rad,
            {"long_name": "centre azimuth of the beam, to port", "units": "rad"},
        )
        places = {"bin_range_m": ranges, "azimuth_rad": azimuths}
        image: DataArray = xarray.DataArray(
            self.image, places, ("bin", "beam"), name="image", attrs=about
        )
        return image


@dataclass(frozen=True, slots=True, eq=False)
class PosedPing(Pictured):
    """A ping and where it was taken: simulated, recorded or remembered.

    Attributes:
        ping: The image.
        pose: The body's pose in the world, as it was believed to be; None if nobody says.
        true_pose: Where the body really was, if that is known and may be another.
    """

    ping: Ping
    pose: Pose | None = None
    true_pose: Pose | None = None

    def plot(self, axes: Axes | None = None, *, power: float = 0.6) -> Axes:
        """Draw the image, as `Ping.plot` does."""
        return self._plotted(axes, power=power)

    def to_xarray(self) -> DataArray:
        """As `Ping.to_xarray`, with the pose, if it is known, as ``x_m`` ... ``yaw_rad``.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        image = self.ping.to_xarray()
        if self.pose is None:
            return image
        return image.assign_coords(dict(zip(POSE, self.pose.numbers, strict=True)))


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box in the world frame."""

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    @classmethod
    def of(cls, low_m: Iterable[float], high_m: Iterable[float]) -> Box:
        """A box from two corners of any kind of sequence."""
        (x0, y0, z0), (x1, y1, z1) = map(float, low_m), map(float, high_m)
        return cls((x0, y0, z0), (x1, y1, z1))

    def moved(self, by_m: Sequence[float]) -> Box:
        """The box moved by a vector."""
        low, high = (
            [c + shift for c, shift in zip(corner, by_m, strict=True)]
            for corner in (self.low_m, self.high_m)
        )
        return Box.of(low, high)

    def relative_to(self, origin_m: Sequence[float]) -> Box:
        """The box as it is told from an origin."""
        return self.moved([-c for c in origin_m])

    def grown(self, margin_m: float) -> Box:
        """The box with ``margin_m`` added on every side."""
        x0, y0, z0 = self.low_m
        x1, y1, z1 = self.high_m
        return Box(
            (x0 - margin_m, y0 - margin_m, z0 - margin_m),
            (x1 + margin_m, y1 + margin_m, z1 + margin_m),
        )

    @property
    def centre_m(self) -> tuple[float, float, float]:
        """The middle of the box."""
        x, y, z = ((low + high) / 2 for low, high in zip(self.low_m, self.high_m, strict=True))
        return (x, y, z)

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Edge lengths."""
        x, y, z = (high - low for low, high in zip(self.low_m, self.high_m, strict=True))
        return (x, y, z)


@dataclass(frozen=True, slots=True)
class ScanPath:
    """One scan: the waypoints at which the sonar pings, in order (Park et al. 2025, eq. 8)."""

    waypoints: tuple[Pose, ...]

    def __post_init__(self) -> None:
        for waypoint in self.waypoints:
            if not isinstance(waypoint, Pose):
                raise GeometryError(f"a waypoint is a Pose, not {waypoint!r}")

    @property
    def length_m(self) -> float:
        """Length of the straight legs between the waypoints."""
        return sum(
            math.dist(a.position_m, b.position_m)
            for a, b in zip(self.waypoints, self.waypoints[1:], strict=False)
        )


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Where a body is when: poses at times that rise."""

    times_s: tuple[float, ...]
    poses: tuple[Pose, ...]

    def __post_init__(self) -> None:
        if not self.poses or len(self.poses) != len(self.times_s):
            raise GeometryError("a trajectory needs poses and a time for each of them")
        if not all(a < b for a, b in zip(self.times_s, self.times_s[1:], strict=False)):
            raise GeometryError("the times of a trajectory must rise; sort them, without repeats")

    @property
    def end_s(self) -> float:
        """The last time."""
        return self.times_s[-1]


@dataclass(frozen=True, slots=True)
class Nav:
    """What the vehicle knows of its own motion: its pose estimate and the scans it has flown."""

    pose: Pose | None
    scans: tuple[ScanPath, ...]


class StopReason(StrEnum):
    """Why a mission ended: a name for programs, and a sentence for people."""

    NOT_WORTH_IT = "not_worth_it"
    NO_CLUSTER = "no_cluster"
    LITTLE_LEFT = "little_left"
    PLAN_FLOWN = "plan_flown"
    SCAN_LIMIT = "scan_limit"
    OBSTACLE = "obstacle"
    NO_WAY = "no_way"
    COLLISION = "collision"
    TOO_SLOW = "too_slow"
    LOST = "lost"
    IMU_FAILED = "imu_failed"
    SILENT = "silent"
    UNANSWERED = "unanswered"
    INTERRUPTED = "interrupted"

    @property
    def sentence(self) -> str:
        """What to tell people."""
        return _SENTENCES[self]


_SENTENCES = {
    StopReason.NOT_WORTH_IT: (
        "No further scan pays: no pose would settle enough of the largest undecided cluster "
        "(entropy.termination)."
    ),
    StopReason.NO_CLUSTER: "No cluster of undecided voxels is left in the designated area.",
    StopReason.LITTLE_LEFT: "Another look at what was found would tell too little.",
    StopReason.PLAN_FLOWN: "All planned scans are flown.",
    StopReason.SCAN_LIMIT: "The limit on the number of scans was reached.",
    StopReason.OBSTACLE: "The next scan path runs into the object or the seabed.",
    StopReason.NO_WAY: "A mapped obstacle bars the way, and no way round it was found.",
    StopReason.COLLISION: "The vehicle ran into the object or the seabed.",
    StopReason.TOO_SLOW: (
        "The vehicle could not keep to its path: the current or the load is too strong."
    ),
    StopReason.LOST: "The vehicle no longer knows where it is: its position is too uncertain.",
    StopReason.IMU_FAILED: "The IMU gives no numbers, and the vehicle cannot navigate without it.",
    StopReason.SILENT: "The sonar has fallen silent.",
    StopReason.UNANSWERED: "No next path came over the bus.",
    StopReason.INTERRUPTED: "The user interrupted the mission.",
}
