"""A vehicle with several sonars flown along waypoints over a world, each pinging on its own clock.

``tour`` yields records as the mission does; writing and showing them is done outside.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from insonify.config.layers import named_tables, overlaid, read_table
from insonify.config.settings import Settings, Table, did_you_mean, validated
from insonify.errors import ConfigError
from insonify.frames import compose
from insonify.imaging.settings import Rendering, WorldSettings
from insonify.scene import Scene
from insonify.scene.probes import hull_contact, ray_query
from insonify.seeds import Stream, generator
from insonify.sonar.devices import Kind, SonarDevice, resolved_device
from insonify.sonar.scanning import head_angles, head_at
from insonify.types import Pose, PosedPing, StopReason
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import Finite, vehicle_named
from insonify.vehicle.instruments import Clock
from insonify.vehicle.settings import VehicleSettings
from insonify.vehicle.voyage import Trouble

Waypoint = tuple[Finite, Finite, Finite, Finite]


class MountedSonar(Settings):
    """A sonar in its place on the vehicle."""

    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$", description="names its files")
    x_m: Finite = 0.0
    y_m: Finite = 0.0
    z_m: Finite = 0.0
    yaw_deg: Finite = Field(0.0, description="turned to the left; its tilt is the device's")
    rate_hz: float = Field(gt=0, le=20, description="pings a second")
    sonar: SonarDevice

    @field_validator("sonar")
    @classmethod
    def _can_be_flown(cls, device: SonarDevice) -> SonarDevice:
        if device.kind in {Kind.SIDESCAN, Kind.PROFILING}:
            raise ValueError(f"a {device.kind} sonar cannot be flown here; take `simulate`")
        return device

    @property
    def place(self) -> Pose:
        """``body_from_base``: where its base is on the body."""
        return Pose(self.x_m, self.y_m, self.z_m, yaw_rad=math.radians(self.yaw_deg))


class Tour(WorldSettings, Rendering):
    """All that is needed to fly the same tour again."""

    waypoints: tuple[Waypoint, ...] = Field(
        min_length=2, description="x, y, z (m), heading (degrees); the first is the start"
    )
    vehicle: VehicleSettings = VehicleSettings(name="bluerov2")
    sonars: tuple[MountedSonar, ...] = Field(min_length=1)

    @field_validator("sonars")
    @classmethod
    def _named_apart(cls, sonars: tuple[MountedSonar, ...]) -> tuple[MountedSonar, ...]:
        names = [sonar.name for sonar in sonars]
        if len(set(names)) < len(names):
            raise ValueError(f"two sonars have the same name: {', '.join(names)}")
        return sonars

    @property
    def route(self) -> tuple[Pose, ...]:
        """The waypoints as poses."""
        return tuple(Pose(x, y, z, yaw_rad=math.radians(yaw)) for x, y, z, yaw in self.waypoints)


def tour_config(layers: Iterable[Table], range_m: float | None = None) -> Tour:
    """The settings of a tour from layers; sonars may name a ``preset``, or be a suite's name.

    Args:
        layers: Settings, each over those before it.
        range_m: Greatest range of all sonars, instead of their own.

    Raises:
        ConfigError: A setting is unknown, missing or out of range.
    """
    table = overlaid([{"sonars": "flatfish", "vehicle": {"name": "bluerov2"}}, *layers])
    if "world" not in table:
        raise ConfigError(
            "name a world: an SDF world, a mesh, a scenario, tank, grid, or structures"
        )
    if "waypoints" not in table:
        raise ConfigError('say where to fly: --waypoints "X Y Z HEADING; ..." or --path FILE')
    if isinstance(table["sonars"], str):
        table["sonars"] = _suite(table["sonars"])
    if isinstance(table["sonars"], list):
        table["sonars"] = [_resolved(one, range_m) for one in table["sonars"]]
    config = validated(Tour, table)
    vehicle_named(config.vehicle.name)
    return config


def _suite(name: str) -> Any:
    """The sonars of a suite by name, or of a TOML file with a list ``sonars``."""
    known = named_tables("tours")
    if name in known:
        return known[name]
    path = Path(name)
    if path.suffix != ".toml":
        raise ConfigError(
            f"there is no set of sonars named {name!r}{did_you_mean(name, known)}, or give a TOML "
            "file"
        )
    sonars = read_table(path, "file of sonars").get("sonars")
    if not isinstance(sonars, list):
        raise ConfigError(f"{path}: has no list of sonars; begin each with [[sonars]]")
    return sonars


def _resolved(mounted: Any, range_m: float | None) -> Any:
    """A mounted sonar with its preset's settings below its own, and a range above them."""
    if not isinstance(mounted, dict) or "sonar" not in mounted:
        return mounted
    device = resolved_device(mounted["sonar"])
    if range_m is not None and isinstance(device, dict):
        device = device | {"range_max_m": range_m}
    return mounted | {"sonar": device}


@dataclass(frozen=True, slots=True, eq=False)
class TourPing:
    """One ping of one sonar.

    Attributes:
        sonar: Its name.
        number: Of this sonar's pings, from 0.
        posed: The image, where the vehicle believed to be, and where it was; the mount of its
            geometry is the whole way from the body.
    """

    sonar: str
    number: int
    posed: PosedPing


class _Mounted:
    """A mounted sonar at work."""

    def __init__(self, mounted: MountedSonar, config: Tour, rng: np.random.Generator) -> None:
        self.mounted = mounted
        self._sonar = config.build(mounted.sonar)
        self._rng = rng
        self._clock = Clock(mounted.rate_hz)
        self._count = 0

    def listen(self, scene: Scene, craft: Craft) -> TourPing | None:
        """A ping, if one is due."""
        if not self._clock.due(craft.time_s):
            return None
        number, self._count = self._count, self._count + 1
        head_rad = head_at(self.mounted.sonar, number)
        true, place = craft.true_pose, self.mounted.place
        base = compose(true, place)
        ping = self._sonar.ping(scene, base, self._rng, head_rad=head_rad, time_s=craft.time_s)
        geometry = ping.geometry
        whole = dataclasses.replace(geometry, mount=compose(place, geometry.mount))
        posed = PosedPing(dataclasses.replace(ping, geometry=whole), craft.estimated_pose, true)
        return TourPing(self.mounted.name, number, posed)


Order = Callable[[Craft], tuple[Pose, ...] | StopReason | None]
"""What follows when a route is flown: another, the end, or nothing yet."""


def tour(
    config: Tour,
    scene: Scene,
    pace: Callable[[float], None] = lambda time_s: None,
    order: Order = lambda craft: StopReason.PLAN_FLOWN,
) -> Iterator[TourPing | Craft | StopReason]:
    """Fly the waypoints; all sonars ping all the way.

    Args:
        config: What to fly.
        scene: Its world.
        pace: Called with the time of every tick; it may wait.
        order: Asked at every tick when the waypoints are flown; until it has an answer the vehicle
            holds its place.

    Yields:
        First the vehicle, then each ping as it comes, last why the tour ended.
    """
    vehicle, route = vehicle_named(config.vehicle.name), config.route
    rng = generator(config.seed, Stream.VEHICLE)
    craft = Craft(vehicle, config.vehicle, route[0], ray_query(scene), rng)
    streams = generator(config.seed, Stream.NOISE).spawn(len(config.sonars))
    sonars = [_Mounted(one, config, own) for one, own in zip(config.sonars, streams, strict=True)]
    trouble = Trouble(hull_contact(scene, vehicle.radius_m))
    yield craft
    craft.follower.follow(route[1:])
    trouble.allow(craft, route)
    while True:
        if craft.follower.finished:
            following = order(craft)
            if isinstance(following, StopReason):
                yield following
                return
            if following is not None:
                craft.follower.follow(following)
            trouble.allow(craft, following or ())
        craft.tick()
        pace(craft.time_s)
        craft.track.readings.clear()
        stop = trouble.met(craft)
        if stop is not None:
            yield stop
            return
        if craft.failed("sonar"):
            continue
        for sonar in sonars:
            ping = sonar.listen(scene, craft)
            if ping is not None:
                yield ping


def turns_of(pings: Iterable[TourPing], mounted: MountedSonar) -> Iterator[list[PosedPing]]:
    """The whole turns of a scanning head, with poses those of its base in the world."""
    steps = len(head_angles(mounted.sonar))
    turn: list[PosedPing] = []
    for one in pings:
        assert one.posed.true_pose is not None
        turn.append(PosedPing(one.posed.ping, compose(one.posed.true_pose, mounted.place)))
        if len(turn) == steps:
            yield turn
            turn = []
