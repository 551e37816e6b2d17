"""Scans flown: the sonar carried along paths by a vehicle that knows only what it measures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from insonify.mapping.voxels import VoxelMap
from insonify.types import Ping, Pose, PosedPing, ScanPath, StopReason
from insonify.vehicle.autopilot.control import settled
from insonify.vehicle.autopilot.guidance import route_length_m
from insonify.vehicle.autopilot.routing import clear_route, is_clear, nose_first, obstacles_near
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import VehicleDescription
from insonify.vehicle.instruments import Clock, RayQuery
from insonify.vehicle.settings import VehicleSettings

_LOOK_S = 0.25
"""How often the truth is asked for a collision."""
_PLAN_S = 2.0
"""How often the route ahead is held against the map."""
_SILENT_PINGS = 5
_HURRY_S = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The true world, as far as it comes to a vehicle.

    Attributes:
        insonify: The sonar in it, from a true pose; the believed one is for its records.
        look: What the Doppler log's rays find.
        touches: Whether the hull, at a true pose, touches something.
    """

    insonify: Callable[[Pose, Pose], Ping]
    look: RayQuery
    touches: Callable[[Pose], bool]


class Trouble:
    """Reasons to end a flight here and now."""

    def __init__(self, touches: Callable[[Pose], bool]) -> None:
        """None yet, and all the time there is.

        Args:
            touches: The world's answer to a true pose.
        """
        self._touches = touches
        self._looks = Clock(1.0 / _LOOK_S)
        self._late_s = math.inf

    def allow(self, craft: Craft, route: tuple[Pose, ...]) -> None:
        """Give a route three times as long as it should take, and a minute."""
        length_m = route_length_m((craft.believed_pose, *route))
        self._late_s = craft.time_s + 3.0 * length_m / craft.settings.guidance.speed_m_s + _HURRY_S

    def met(self, craft: Craft) -> StopReason | None:
        """Why to stop, if there is a reason."""
        if craft.lost is not None:
            return craft.lost
        if self._looks.due(craft.time_s) and self._touches(craft.true_pose):
            return StopReason.COLLISION
        return StopReason.TOO_SLOW if craft.time_s > self._late_s else None


class Voyage:
    """Carries the sonar along one scan after another (a `mission.loop.Carrier`).

    Between scans the vehicle flies to where the next begins; the sonar pings, at its own rate, on
    the scans alone.  Routes keep clear of what the map knows.
    """

    def __init__(
        self,
        vehicle: VehicleDescription,
        settings: VehicleSettings,
        clearance_m: float,
        world: Surroundings,
        rng: np.random.Generator,
        pace: Callable[[float], None] = lambda time_s: None,
    ) -> None:
        """Prepare; the vehicle is put into the water where its first scan begins.

        Args:
            vehicle: What flies.
            settings: How it flies.
            clearance_m: Least distance between its hull and anything the map knows.
            world: What it is in.
            rng: The vehicle's randomness.
            pace: Called with the time of every tick; it may wait.
        """
        self.vehicle, self.settings = vehicle, settings
        self.craft: Craft | None = None
        self._clearance_m = clearance_m + vehicle.radius_m
        self._world = world
        self._rng, self._pace = rng, pace
        self._pings = Clock(settings.ping_hz)
        self._trouble = Trouble(world.touches)

    def carry(self, path: ScanPath, voxels: VoxelMap) -> Iterator[PosedPing | StopReason]:
        """Fly to a scan and along it.

        Yields:
            Each ping with the pose that the vehicle believes it was taken at; or, last, the reason
            why the scan ended before its end.
        """
        first = path.waypoints[0]
        if self.craft is None:
            self.craft = Craft(self.vehicle, self.settings, first, self._world.look, self._rng)
        craft = self.craft
        route = self._route(craft, (first,), voxels)
        if route is None:
            yield StopReason.NO_WAY
            return
        route = nose_first(craft.believed_pose, route)
        for stop in self._fly(craft, route, voxels, scanning=False):
            yield stop
            return
        route = self._route(craft, path.waypoints, voxels)
        if route is None:
            yield StopReason.NO_WAY
            return
        yield from self._fly(craft, route, voxels, scanning=True)

    def _fly(
        self, craft: Craft, route: tuple[Pose, ...], voxels: VoxelMap, *, scanning: bool
    ) -> Iterator[PosedPing | StopReason]:
        """Follow a route to its end; pings come only while scanning."""
        craft.follower.follow(route)
        self._trouble.allow(craft, route)
        heard_s, pinged = craft.time_s, False
        plans = Clock(1.0 / _PLAN_S, craft.time_s + _PLAN_S)
        while not self._arrived(craft, scanning) or (scanning and not pinged):
            craft.tick()
            self._pace(craft.time_s)
            stop = self._trouble.met(craft)
            if stop is not None:
                yield stop
                return
            if scanning and self._pings.due(craft.time_s) and not craft.failed("sonar"):
                heard_s, pinged = craft.time_s, True
                true, believed = craft.true_pose, craft.estimated_pose
                ping = replace(self._world.insonify(true, believed), time_s=craft.time_s)
                yield PosedPing(ping, believed, true)
            if scanning and craft.time_s - heard_s > _SILENT_PINGS / self.settings.ping_hz:
                yield StopReason.SILENT
                return
            if plans.due(craft.time_s) and not self._still_clear(craft, voxels):
                around = self._route(craft, craft.follower.remaining(), voxels)
                if around is None:
                    yield StopReason.NO_WAY
                    return
                craft.follower.follow(around)
                self._trouble.allow(craft, around)

    def _arrived(self, craft: Craft, scanning: bool) -> bool:
        if not craft.follower.finished:
            return False
        within_m = 0.3 if scanning else 0.15
        return settled(craft.motion(), craft.follower.set_point, within_m, 0.06)

    def _route(
        self, craft: Craft, waypoints: tuple[Pose, ...], voxels: VoxelMap
    ) -> tuple[Pose, ...] | None:
        here = craft.believed_pose
        obstacles = obstacles_near(voxels, (here, *waypoints), self._clearance_m)
        return clear_route(here, waypoints, obstacles, self._clearance_m)

    def _still_clear(self, craft: Craft, voxels: VoxelMap) -> bool:
        ahead = craft.follower.remaining()
        here = craft.believed_pose
        obstacles = obstacles_near(voxels, (here, *ahead), self._clearance_m)
        legs = zip((here, *ahead), ahead, strict=False)
        return all(is_clear(a, b, obstacles, self._clearance_m) for a, b in legs)
