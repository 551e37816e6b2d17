"""The next scan's path from the map as it stands, never nearer to it than the clearance.

What is planned from is a copy: the part of the map that the planner and the way can depend on, as
it was when the path was asked for.  So it can be planned from in a thread while pings are mapped,
and from the same messages the same path comes, however long either takes.
"""

from __future__ import annotations

import copy
import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np

from insonify import memory
from insonify.errors import InsonifyError, MemoryLimitError
from insonify.mapping.factory import MAPPERS
from insonify.mapping.mapper import Belief, Mapper
from insonify.mapping.voxels import BYTES_PER_VOXEL, VOXELS_PER_BLOCK, VoxelMap, touching
from insonify.planning.active import EntropySettings
from insonify.planning.candidates import straight_path
from insonify.planning.decision import Decision
from insonify.planning.once import half_diagonal_m, plan_next
from insonify.types import Bool, Box, FanGeometry, Pose, ScanPath, StopReason
from insonify.vehicle.autopilot.leading import lead_to

_NUMBA: Any = numba
REACHED_M = 0.5
"""A waypoint is reached when the vehicle has been so near."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What is answered to who asks for the next scan.

    Attributes:
        path: In the map's frame; None if there is none to fly.
        why: The reason if there is none, else what the path is for.
        clear_m: The way there and the path come no nearer to what is mapped.
        way: The poses to the path's first one, which is the last of them.
        decision: What the planner saw; None if it was not asked.
    """

    path: ScanPath | None
    why: str
    clear_m: float = math.inf
    way: tuple[Pose, ...] = ()
    decision: Decision | None = None

    @property
    def waypoints(self) -> tuple[Pose, ...]:
        """All that is to be flown: round what is mapped to the scan, and the scan."""
        return () if self.path is None else (*self.way[:-1], *self.path.waypoints)


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """What a path is planned from, in the map's frame.

    Attributes:
        belief: What is known, unchanged by what is mapped meanwhile.
        region: Where uncertainty counts; None for around what is occupied.
        geometry: The sonar.
        pose: Where the vehicle is.
        stamp_ns: Of the last ping in the map.
    """

    belief: Belief
    region: Box | None
    geometry: FanGeometry
    pose: Pose
    stamp_ns: int


@dataclass(slots=True)
class Pilot:
    """Plans one scan after another, and knows when one is flown.

    Attributes:
        region: Where uncertainty counts, in the world; None for around what is occupied.
        settings: The entropy planner's.
        waypoints: Of each scan.
        clearance_m: Least distance of the way and the scan to what is mapped.
        sent: How many paths were answered, but for those that another took the place of before
            they were begun.
    """

    region: Box | None
    settings: EntropySettings
    waypoints: int
    clearance_m: float
    sent: int = 0
    _ahead: ScanPath | None = None
    _begun: bool = False

    def question(
        self, mapper: Mapper, geometry: FanGeometry, pose: Pose, stamp_ns: int = 0
    ) -> Question:
        """What a path from here is to be planned from.

        Args:
            mapper: What is known; it may map on.
            geometry: The sonar.
            pose: Where the vehicle is, in the map's frame.
            stamp_ns: Of the last ping in the map.

        Raises:
            MemoryLimitError: There is no memory for it.
        """
        voxels = mapper.voxels
        box = None if self.region is None else self.region.relative_to(voxels.origin_m)
        belief: Belief = mapper
        if mapper.name in MAPPERS:  # which tell what a look would from their voxels alone
            belief = copy.copy(mapper)
            belief.voxels = _part(voxels, self._needed(voxels, box, geometry, pose))
        return Question(belief, box, geometry, pose, stamp_ns)

    def answer(self, question: Question) -> Answer:
        """The scan that resolves most, of those that keep clear; and the way there."""
        voxels, pose = question.belief.voxels, question.pose
        if self.sent - self._waits >= self.settings.max_scans:
            return Answer(None, f"{self.sent} scans are planned, the most (entropy.max_scans)")
        region = question.region or voxels.around_occupied()
        decision = plan_next(
            question.belief, question.geometry, region, pose, self.settings, self.waypoints
        )
        if decision.path is None or decision.look is None:
            return Answer(None, decision.why_not or "", decision=decision)
        look = decision.look
        least = look.termination * look.cluster.entropy
        x_c, y_c, _ = look.cluster.centre_m
        whys: list[str] = []
        for best in np.argsort(-look.h_sum, kind="stable").tolist():
            if look.h_cluster[best] <= least:
                continue
            path = straight_path(look.candidates[best], (x_c, y_c), self.waypoints)
            lead = lead_to(voxels, pose, path, self.clearance_m)
            if lead.way is not None:
                chosen = Decision(path=path, look=replace(look, best=best))
                why = f"{look.cluster.entropy:.0f} bits are undecided"
                return Answer(path, why, lead.near_m, lead.way, chosen)
            whys.append(lead.why)
        count = f"none of {len(whys)} scans worth flying can be: " if len(whys) > 1 else ""
        none = Decision(stop=StopReason.NO_WAY, look=look)
        return Answer(None, count + whys[0], decision=none)

    def sends(self, answer: Answer) -> None:
        """Note that an answer goes out: if it has a path, that is to be flown now."""
        if answer.path is not None:
            self.sent += not self._waits
            self._ahead, self._begun = answer.path, False

    @property
    def _waits(self) -> bool:
        """Whether the path that was sent last is not begun yet."""
        return self._ahead is not None and not self._begun

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

    def _needed(
        self, voxels: VoxelMap, region: Box | None, geometry: FanGeometry, pose: Pose
    ) -> Bool:
        """Which blocks a path may depend on; without a region, all.

        What a candidate could see: they lie at the vehicle's height around a cluster's centre in
        the region, no farther than its radius or the range.  And what could be in the way: all
        within the clearance of that height.
        """
        if region is None:
            return np.ones(voxels.block_count, bool)
        far_m = geometry.range_max_m
        half_m = math.hypot(*region.size_m) / 2
        reach_m = max(half_m, far_m) + far_m + math.hypot(*geometry.mount.position_m)
        low, high = (
            np.array([*corner[:2], choose(corner[2], pose.z_m)])
            for corner, choose in ((region.low_m, min), (region.high_m, max))
        )
        around = touching(voxels.coords, voxels.block_m, Box.of(low, high).grown(reach_m))
        margin_m = self.clearance_m + half_diagonal_m(voxels) + voxels.voxel_m
        low_m = voxels.coords[:, 2].astype(np.float64) * voxels.block_m
        beside = low_m <= pose.z_m + margin_m
        beside &= low_m + voxels.block_m >= pose.z_m - margin_m
        return np.asarray(around | beside, bool)


class Desk:
    """Where one path at a time is planned: in a thread beside the mapping, or at once.

    At once is for a recording, which can wait; for a mapper of a user's own, which cannot be
    copied; and where numba has only threads that must not be started from two (`workqueue`).
    """

    def __init__(self, *, beside: bool = True) -> None:
        """Nothing is planned yet.

        Args:
            beside: Whether to plan in a thread, where that can be.
        """
        self._beside = beside
        self._threads: ThreadPoolExecutor | None = None
        self._planned: Future[Answer] | None = None
        self._question: Question | None = None

    @property
    def busy(self) -> bool:
        """Whether a path is being planned, or waits to be taken."""
        return self._planned is not None

    def plan(self, pilot: Pilot, question: Question) -> None:
        """Plan a path; none other may be planned."""
        self._question = question
        if self._beside and _can_share(question):
            self._threads = self._threads or ThreadPoolExecutor(1, "planning")
            self._planned = self._threads.submit(_answered, pilot, question)
            return
        self._planned = Future()
        self._planned.set_result(_answered(pilot, question))

    def take(self, *, wait: bool = False) -> tuple[Question, Answer] | None:
        """What was planned, if it is done; with ``wait`` as soon as it is."""
        planned, question = self._planned, self._question
        if planned is None or question is None or not (wait or planned.done()):
            return None
        self._planned = self._question = None
        return question, planned.result()


def _answered(pilot: Pilot, question: Question) -> Answer:
    try:
        return pilot.answer(question)
    except InsonifyError as err:  # no memory, for one: there is no path, and mapping goes on
        return Answer(None, str(err))


def _can_share(question: Question) -> bool:
    """Whether a path can be planned while pings are mapped."""
    if getattr(question.belief, "name", "") not in MAPPERS:
        return False
    try:
        return bool(_NUMBA.threading_layer() != "workqueue")
    except ValueError:  # no kernel has run yet
        return False


def _part(voxels: VoxelMap, kept: Bool) -> VoxelMap:
    """A copy of some blocks of a map.

    Raises:
        MemoryLimitError: It would not fit.
    """
    needed = 2.0 * float(kept.sum()) * VOXELS_PER_BLOCK * BYTES_PER_VOXEL
    if not memory.fits(needed):
        raise MemoryLimitError(f"to plan would take {memory.shortage(needed)}; give a --region")
    part = VoxelMap(voxels.voxel_m, origin_m=voxels.origin_m)
    blocks = voxels.read(voxels.coords[kept])
    part.allocate(blocks.coords)
    part.log_odds[:], part.seen[:] = blocks.log_odds, blocks.seen
    return part
