"""What every planner is asked, and what it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from insonify.mapping.mapper import Belief
from insonify.planning.clusters import Cluster
from insonify.types import Box, Float32, Float64, Nav, Pose, ScanPath, StopReason


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
        termination: TC: the share of C_max's entropy that must be exceeded (eq. 9).
    """

    cluster: Cluster
    candidates: tuple[Pose, ...]
    h_sum: Float64
    h_cluster: Float64
    best: int
    termination: float


@dataclass(frozen=True, slots=True)
class Decision:
    """The next scan, or the reason to stop; exactly one of them is given."""

    path: ScanPath | None = None
    stop: StopReason | None = None
    look: Look | None = None

    def __post_init__(self) -> None:
        if (self.path is None) == (self.stop is None):
            raise ValueError("a decision is either a path or a reason to stop")
        if self.stop is not None and not isinstance(self.stop, StopReason):
            raise ValueError(f"a reason to stop is a StopReason, not {self.stop!r}")
        if self.path is not None and not isinstance(self.path, ScanPath):
            raise ValueError(f"a path is a ScanPath, not {self.path!r}")
        if self.path is not None and not self.path.waypoints:
            raise ValueError("a path needs a waypoint at least")

    @property
    def why_not(self) -> str | None:
        """Why nothing is to be scanned, in a sentence, with the numbers that were compared."""
        if self.stop is not StopReason.NOT_WORTH_IT or self.look is None:
            return None if self.stop is None else self.stop.sentence
        look = self.look
        percent = 100.0 * float(look.h_cluster[look.best] / look.cluster.entropy)
        return (
            f"No further scan pays: the best of {len(look.candidates)} poses would settle "
            f"{percent:.2g} % of the largest undecided cluster, not more than the "
            f"{100.0 * look.termination:.3g} % that are asked (entropy.termination)."
        )


class Planner(Protocol):
    """Decides, from what is believed alone, where to scan next."""

    name: str

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        """The next scan path, or a reason to stop; ``nav.scans`` is empty before the first."""


@dataclass(frozen=True, slots=True, eq=False)
class DecisionRecord:
    """A decision as it is kept.

    Attributes:
        pings: How many were mapped before it.
        decision: The answer.
        entropy_bits: (nx, ny) entropy of the designated area summed over height, not a number
            where no voxel has been in view; None before the first scan.
    """

    pings: int
    decision: Decision
    entropy_bits: Float32 | None = None
