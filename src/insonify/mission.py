"""The mission loop of Park et al. 2025, Fig. 2: scan, map, find what is uncertain, scan there.

The loop only yields what happened.  Recording, showing, scoring and timing are done by whoever
consumes it, outside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from insonify.errors import GeometryError
from insonify.mapping.bayes import Mapper
from insonify.planning.decision import Decision, Planner, StopReason
from insonify.types import Nav, Ping, Pose, ScanPath


@dataclass(frozen=True, slots=True, eq=False)
class Decided:
    """The planner has answered."""

    decision: Decision


@dataclass(frozen=True, slots=True, eq=False)
class Pinged:
    """The sonar has pinged at a waypoint."""

    pose: Pose
    ping: Ping


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


def fly(
    insonify: Callable[[Pose], Ping],
    mapper: Mapper,
    planner: Planner,
    first_collision: Callable[[ScanPath], Pose | None],
) -> Iterator[Step]:
    """Scan until the planner stops.

    Args:
        insonify: The sonar in its world: one ping from a vehicle pose.
        mapper: Builds the map.
        planner: Decides from the map alone.
        first_collision: The world's answer to a path: where it would hit something, or None.

    Yields:
        One record a step, each as soon as the step is done.

    Raises:
        GeometryError: The very first path runs into something.
    """
    nav = Nav(None, ())
    while True:
        decision = planner.next_scan(mapper.voxels, nav)  # entropy map, C_max, candidates, H_sum
        yield Decided(decision)
        if decision.stop is not None:
            yield Ended(decision.stop)
            return
        assert decision.path is not None
        hit = first_collision(_with_transit(nav, decision.path))
        if hit is not None and not nav.scans:
            raise GeometryError(collision_message(hit))
        if hit is not None:
            yield Ended(StopReason.OBSTACLE)
            return
        for pose in decision.path.waypoints:
            ping = insonify(pose)  # sonar
            yield Pinged(pose, ping)
            mapper.integrate(ping, pose)  # 3D occupancy map
            yield Mapped()
        nav = Nav(decision.path.waypoints[-1], (*nav.scans, decision.path))
        yield Scanned(decision.path)


def _with_transit(nav: Nav, path: ScanPath) -> ScanPath:
    """A scan with the straight leg that leads to it."""
    return path if nav.pose is None else ScanPath((nav.pose, *path.waypoints))


def collision_message(hit: Pose) -> str:
    """What to tell the user of a path that hits something."""
    x, y, z = (round(c, 2) for c in hit.position_m)
    return (
        f"the vehicle's path comes too near to the object or the seabed at ({x:g}, {y:g}, {z:g}) "
        "m; fly higher (--set survey.altitude_m=...) or allow less clearance "
        "(--set survey.clearance_m=...)"
    )
