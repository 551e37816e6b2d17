"""The next scan's path from the map as it stands, never nearer to it than the clearance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from insonify.mapping.mapper import Mapper
from insonify.planning.active import EntropySettings
from insonify.planning.candidates import straight_path
from insonify.planning.once import clearance_m, plan_next
from insonify.types import Box, FanGeometry, Pose, ScanPath

REACHED_M = 0.5
"""A waypoint is reached when the vehicle has been so near."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What is answered to who asks for the next scan.

    Attributes:
        path: In the map's frame; None if there is none to fly.
        why: The reason if there is none, else what the path is for.
        clear_m: How near the way there and the path come to what is mapped.
    """

    path: ScanPath | None
    why: str
    clear_m: float = math.inf


@dataclass(slots=True)
class Pilot:
    """Plans one scan after another, and knows when one is flown.

    Attributes:
        region: Where uncertainty counts, in the world; None for around what is occupied.
        settings: The entropy planner's.
        waypoints: Of each scan.
        clearance_m: Least distance of the way and the scan to what is mapped.
        sent: How many paths were answered.
    """

    region: Box | None
    settings: EntropySettings
    waypoints: int
    clearance_m: float
    sent: int = 0
    _ahead: ScanPath | None = None
    _begun: bool = False

    def next_scan(self, mapper: Mapper, geometry: FanGeometry, pose: Pose) -> Answer:
        """The scan that resolves most, of those that keep clear.

        Args:
            mapper: What is known.
            geometry: The sonar.
            pose: Where the vehicle is, in the map's frame.
        """
        voxels = mapper.voxels
        region = self.region
        box = voxels.around_occupied() if region is None else region.relative_to(voxels.origin_m)
        if self.sent >= self.settings.max_scans:
            return Answer(None, f"{self.sent} scans are planned, the most (entropy.max_scans)")
        decision = plan_next(mapper, geometry, box, pose, self.settings, self.waypoints)
        if decision.path is None or decision.look is None:
            return Answer(None, decision.why_not or "")
        look = decision.look
        least = look.termination * look.cluster.entropy
        x_c, y_c, _ = look.cluster.centre_m
        nearest = math.inf
        for best in np.argsort(-look.h_sum, kind="stable"):
            if look.h_cluster[best] <= least:
                continue
            path = straight_path(look.candidates[best], (x_c, y_c), self.waypoints)
            near_m = clearance_m(voxels, [pose, path.waypoints[0], path.waypoints[-1]])
            if near_m >= self.clearance_m:
                self.sent += 1
                self._ahead, self._begun = path, False
                return Answer(path, f"{look.cluster.entropy:.0f} bits are undecided", near_m)
            nearest = min(nearest, near_m)
        return Answer(
            None,
            f"every scan worth flying, or the way there, comes within {nearest:.2f} m of what is "
            f"mapped, and {self.clearance_m:g} m is the least",
            nearest,
        )

    def flown(self, pose: Pose) -> bool:
        """Whether a pose ends the scan that was sent last: its begin was reached, now its end."""
        if self._ahead is None:
            return False
        first, last = self._ahead.waypoints[0], self._ahead.waypoints[-1]
        self._begun |= math.dist(pose.position_m, first.position_m) <= REACHED_M
        if not self._begun or math.dist(pose.position_m, last.position_m) > REACHED_M:
            return False
        self._ahead = None
        return True
