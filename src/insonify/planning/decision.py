"""What every planner is asked, and what it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from insonify.mapping.voxels import VoxelMap
from insonify.planning.clusters import Cluster
from insonify.types import Box, Float64, Nav, Pose, ScanPath


class StopReason(Enum):
    """Why a mission ended, as a sentence for the user."""

    NOT_WORTH_IT = "No candidate pose would resolve more than TC of the largest cluster's entropy."
    NO_CLUSTER = "No cluster of undecided voxels is left in the designated area."
    PLAN_FLOWN = "All planned scans are flown."
    SCAN_LIMIT = "The limit on the number of scans was reached."
    OBSTACLE = "The next scan path runs into the object or the seabed."
    NO_WAY = "A mapped obstacle bars the way, and no way round it was found."
    COLLISION = "The vehicle ran into the object or the seabed."
    TOO_SLOW = "The vehicle could not keep to its path: the current or the load is too strong."
    LOST = "The vehicle no longer knows where it is: its position is too uncertain."
    IMU_FAILED = "The IMU gives no numbers, and the vehicle cannot navigate without it."
    SILENT = "The sonar has fallen silent."
    INTERRUPTED = "The user interrupted the mission."


@dataclass(frozen=True, slots=True)
class SurveyArea:
    """The designated area and how it is scanned: the mission's order, known before the first ping.

    Attributes:
        region: Where uncertainty counts; its floor keeps clear of the expected seabed.
        z_m: The constant height z_initial of all scans, world frame.
        heading_rad: Yaw of the first scan.
        approach_m: How far before the region a scan over its centre begins.
        overrun_m: Where it ends, beyond the centre.
        waypoints: k, the waypoints (and pings) of each scan.
    """

    region: Box
    z_m: float
    heading_rad: float
    approach_m: float
    overrun_m: float
    waypoints: int

    def extent_m(self, heading_rad: float) -> float:
        """Horizontal extent of the region along a heading."""
        size_x, size_y, _ = self.region.size_m
        return abs(size_x * math.cos(heading_rad)) + abs(size_y * math.sin(heading_rad))


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The reasoning behind an entropy planner's decision, for reports.

    Attributes:
        cluster: C_max.
        candidates: P_sample.
        h_sum: (N,) what each candidate would see (eq. 6), bits.
        h_cluster: (N,) the part of it that is C_max's.
        best: Index of the argmax (eq. 7).
    """

    cluster: Cluster
    candidates: tuple[Pose, ...]
    h_sum: Float64
    h_cluster: Float64
    best: int


@dataclass(frozen=True, slots=True)
class Decision:
    """The next scan, or the reason to stop; exactly one of them is given."""

    path: ScanPath | None = None
    stop: StopReason | None = None
    look: Look | None = None

    def __post_init__(self) -> None:
        if (self.path is None) == (self.stop is None):
            raise ValueError("a decision is either a path or a reason to stop")
        if self.path is not None and not self.path.waypoints:
            raise ValueError("a path needs a waypoint at least")


class Planner(Protocol):
    """Decides, from the map alone, where to scan next."""

    name: str

    def next_scan(self, voxels: VoxelMap, nav: Nav) -> Decision:
        """The next scan path, or a reason to stop; ``nav.scans`` is empty before the first."""
