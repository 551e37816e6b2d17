"""The mission loop of Park et al. 2025, Fig. 2: scan, map, find what is uncertain, scan there.

The loop only yields what happened.  Recording, showing, scoring and timing are done by whoever
consumes it, outside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from insonify.errors import ConfigError, GeometryError
from insonify.mapping.mapper import Mapper
from insonify.mapping.voxels import VoxelMap
from insonify.planning.decision import Decision, Planner
from insonify.types import Nav, Ping, Pose, PosedPing, ScanPath, StopReason


@dataclass(frozen=True, slots=True, eq=False)
class Decided:
    """The planner has answered."""

    decision: Decision


@dataclass(frozen=True, slots=True, eq=False)
class Pinged:
    """The sonar has pinged at a waypoint."""

    posed: PosedPing


@dataclass(frozen=True, slots=True)
class Mapped:
    """The map holds the last ping."""


@dataclass(frozen=True, slots=True)
class Scanned:
    """A scan is flown to its end."""

    path: ScanPath


@dataclass(frozen=True, slots=True)
class Ended:
    """The mission is over."""

    reason: StopReason


Step = Decided | Pinged | Mapped | Scanned | Ended


class Carrier(Protocol):
    """What carries the sonar along a scan: a vehicle, or the mere thought of one."""

    def carry(self, path: ScanPath, voxels: VoxelMap) -> Iterator[PosedPing | StopReason]:
        """Take the sonar to a scan and along it.

        Yields:
            Each ping with the pose at which it is believed to be taken; or, last, why the scan
            ended before its end.
        """


def fly(carrier: Carrier, mapper: Mapper, planner: Planner) -> Iterator[Step]:
    """Scan until the planner stops, or the carrier cannot go on.

    Args:
        carrier: The sonar in its world, and what takes it there.
        mapper: Builds the map.
        planner: Decides from what the mapper believes alone.

    Yields:
        One record a step, each as soon as the step is done.

    Raises:
        GeometryError: The very first path cannot be flown.
        ConfigError: The planner's answer is none.
    """
    nav = Nav(None, ())
    while True:
        decision = planner.next_scan(mapper, nav)  # entropy map, C_max, candidates, H_sum
        if not isinstance(decision, Decision):
            raise ConfigError(f"planner {planner.name!r} gave {decision!r}, which is no Decision")
        yield Decided(decision)
        if decision.stop is not None:
            yield Ended(decision.stop)
            return
        assert decision.path is not None
        pose = nav.pose
        for posed in carrier.carry(decision.path, mapper.voxels):
            if isinstance(posed, StopReason):
                yield Ended(posed)
                return
            assert posed.pose is not None
            pose = posed.pose
            yield Pinged(posed)  # sonar
            mapper.integrate(posed.ping, pose)  # 3D occupancy map
            yield Mapped()
        mapper.finish_scan()
        nav = Nav(pose, (*nav.scans, decision.path))
        yield Scanned(decision.path)


class Teleport:
    """No vehicle: the sonar is at each waypoint in turn (a `Carrier`)."""

    def __init__(
        self,
        insonify: Callable[[Pose, Pose], Ping],
        first_collision: Callable[[ScanPath], Pose | None],
        believe: Callable[[Pose], Pose] = lambda pose: pose,
    ) -> None:
        """Begin nowhere.

        Args:
            insonify: The sonar in its world: one ping from a true pose; the believed one is for
                its records.
            first_collision: The world's answer to a path: where it would hit something, or None.
            believe: What a true pose is taken for.
        """
        self._insonify, self._first_collision, self._believe = insonify, first_collision, believe
        self._pose: Pose | None = None

    def carry(self, path: ScanPath, voxels: VoxelMap) -> Iterator[PosedPing | StopReason]:
        """Ping at every waypoint, if the straight way there and along them is free.

        Raises:
            GeometryError: The very first path runs into something.
        """
        way = path if self._pose is None else ScanPath((self._pose, *path.waypoints))
        hit = self._first_collision(way)
        if hit is not None and self._pose is None:
            raise GeometryError(collision_message(hit))
        if hit is not None:
            yield StopReason.OBSTACLE
            return
        for pose in path.waypoints:
            believed = self._believe(pose)
            yield PosedPing(self._insonify(pose, believed), believed, pose)
        self._pose = path.waypoints[-1]


def collision_message(hit: Pose) -> str:
    """What to tell the user of a path that hits something."""
    x, y, z = (round(c, 2) for c in hit.position_m)
    return (
        f"the vehicle's path comes too near to the object or the seabed at ({x:g}, {y:g}, {z:g}) "
        "m; fly higher (--set survey.altitude_m=...) or allow less clearance "
        "(--set survey.clearance_m=...)"
    )
