"""What the page can show: every ping of a run or recording, and the map as it was after it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from insonify.evaluation import Solid, solids_of
from insonify.mapping.voxels import VoxelMap
from insonify.mission.loop import Decided, Ended, Mapped, Pinged, Step
from insonify.mission.run import Run
from insonify.planning.decision import Decision
from insonify.types import Array, Box, FanGeometry, Pose, PosedPing
from insonify.view.cubes import Cubes, occupied_cubes, undecided_cubes

MOST_BYTES = 256 << 20
"""Memory for the sonar images of a story, and for the pictures of its map."""
MOST_MOMENTS = 50_000
"""Of a story that may go on for days; beyond, it is to be halved."""

Item = TypeVar("Item")


class Thinned(Generic[Item]):
    """Items of a sequence of unknown length within a memory limit: all, then every second...

    One thread may add while another asks.
    """

    def __init__(self, most_bytes: int = MOST_BYTES, stride: int = 1) -> None:
        """Empty; ``stride`` is what it begins with."""
        self._most_bytes = most_bytes
        self._kept: tuple[int, dict[int, tuple[Item, int]]] = (stride, {})
        self._bytes = 0
        self._last: tuple[int, Item] | None = None

    @property
    def stride(self) -> int:
        """How many items there are for each that is kept."""
        return self._kept[0]

    def wants(self, number: int) -> bool:
        """Whether item ``number``, counted from 1, would be kept."""
        return (number - 1) % self.stride == 0

    def add(self, number: int, item: Item, size_bytes: int) -> None:
        """Take an item; the last one added is kept whatever its number."""
        self._last = (number, item)
        stride, kept = self._kept
        if self.wants(number):
            kept[number] = (item, size_bytes)
            self._bytes += size_bytes
        while len(kept) > 1 and self._bytes > self._most_bytes:
            stride *= 2
            kept = {n: pair for n, pair in kept.items() if (n - 1) % stride == 0}
            self._bytes = sum(size for _, size in kept.values())
            self._kept = (stride, kept)

    def at(self, number: int) -> tuple[int, Item] | None:
        """The last item kept up to a number, with its own number; None before the first."""
        last = self._last
        if last is not None and last[0] <= number:
            return last
        stride, kept = self._kept
        nearest = (number - 1) // stride * stride + 1
        while nearest > 0:
            if nearest in kept:
                return nearest, kept[nearest][0]
            nearest -= stride
        return None

    def halved(self) -> Thinned[Item]:
        """The same of a sequence of which every other item is left out, from the second on."""
        stride, kept = self._kept
        half: Thinned[Item] = Thinned(self._most_bytes, max(1, stride // 2))
        found = {(n + 1) // 2: pair for n, pair in kept.items() if n % 2}
        half._kept = (half.stride, found)
        half._bytes = sum(size for _, size in found.values())
        if self._last is not None and self._last[0] % 2:
            half._last = ((self._last[0] + 1) // 2, self._last[1])
        return half


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One ping.

    Attributes:
        time_s: When.
        geometry: The fan that was looked at.
        pose: The vehicle's, as it was believed to be; None if nobody says.
        true_pose: Where it really was, if that is known and another.
        scan: Number of the scan, from 1.
    """

    time_s: float
    geometry: FanGeometry
    pose: Pose | None
    true_pose: Pose | None
    scan: int


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """The map at a moment: occupied voxels inside the region and outside it, and undecided ones."""

    occupied: Cubes
    elsewhere: Cubes
    undecided: Cubes

    @property
    def size_bytes(self) -> int:
        """Memory that it takes."""
        return sum(part.size_bytes for part in (self.occupied, self.elsewhere, self.undecided))


@dataclass(slots=True, eq=False)
class Story:
    """What happened, growing while it happens.

    Attributes:
        title: What it is of.
        moments: The pings in order.
        images: Their images, (bins, beams) uint8.
        maps: The map after them; of a story without pings at number 0.
        decisions: What the planner answered, each with the number of pings mapped before it.
        world: The true world, if it is known.
        region: Where uncertainty counts.
        end: Why it ended, as a sentence.
        changed: Called after each change.
        pings: How many there were, and ``stride`` how many for each of the moments.
    """

    title: str
    moments: list[Moment] = field(default_factory=list)
    images: Thinned[Array] = field(default_factory=Thinned)
    maps: Thinned[MapPicture] = field(default_factory=Thinned)
    decisions: list[tuple[int, Decision]] = field(default_factory=list)
    world: tuple[Solid, ...] = ()
    region: Box | None = None
    end: str = ""
    changed: Callable[[], None] = lambda: None
    pings: int = 0
    stride: int = 1

    def add_ping(self, posed: PosedPing, scan: int = 1) -> None:
        """Note a ping."""
        self.pings += 1
        if (self.pings - 1) % self.stride:
            return
        ping, pose = posed.ping, posed.pose
        other = None if posed.true_pose == pose else posed.true_pose
        grey = np.round(np.clip(ping.image, 0.0, 1.0) * 255.0).astype(np.uint8)
        self.images.add(len(self.moments) + 1, grey, grey.nbytes)  # before a page looks for it
        self.moments.append(Moment(ping.time_s, ping.geometry, pose, other, scan))

    def ping_of(self, number: int) -> int:
        """Which ping a moment is, both from 1; 0 of none."""
        return (number - 1) * self.stride + 1 if number else 0

    def add_map(self, voxels: VoxelMap, region: Box) -> None:
        """Note the map as it is after the last ping noted."""
        picture = MapPicture(*occupied_cubes(voxels, region), undecided_cubes(voxels, region))
        self.maps.add(len(self.moments), picture, picture.size_bytes)
        self.region = region

    def halved(self) -> Story:
        """The same with every other moment, for one that goes on for long; this one stays."""
        return replace(
            self,
            moments=self.moments[::2],
            images=self.images.halved(),
            maps=self.maps.halved(),
            decisions=[((after + 1) // 2, decision) for after, decision in self.decisions],
            stride=2 * self.stride,
        )

    def decision_at(self, number: int) -> Decision | None:
        """The last decision when ``number`` pings were mapped."""
        made = [decision for after, decision in self.decisions if after <= number]
        return made[-1] if made else None

    def watch(self, run: Run, step: Step) -> None:
        """Note a step of a run: a consumer of the mission, like progress or a recording."""
        if not self.world:
            self.world = solids_of(run.world.scene)
            self.region = run.world.area.region
        if isinstance(step, Decided):
            self.decisions.append((run.pings, step.decision))
        elif isinstance(step, Pinged):
            self.add_ping(step.posed, len(run.paths))
        elif isinstance(step, Mapped) and self.maps.wants(len(self.moments)):
            self.add_map(run.mapper.voxels, run.world.area.region)
        elif isinstance(step, Ended):
            self.add_map(run.mapper.voxels, run.world.area.region)
            self.end = run.why_stopped
        self.changed()
