"""A vehicle with several sonars flown along waypoints over a world, each pinging on its own clock.

``tour`` yields records as the mission does; writing and showing them is done outside.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from insonify.errors import ConfigError
from insonify.frames import compose
from insonify.planning.decision import StopReason
from insonify.scenarios import Table, explain, overlay
from insonify.scene import Scene
from insonify.scene.sounding import hull_contact, sounder
from insonify.sonar import Sonar
from insonify.sonar.devices import Kind, SonarDevice, with_preset
from insonify.sonar.formation import ImageSettings
from insonify.sonar.sampling import SamplingSettings
from insonify.sonar.scanning import HeadPing, head_angles, head_at
from insonify.types import Ping, Pose
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import Finite, vehicle_named
from insonify.vehicle.guidance import route_length_m
from insonify.vehicle.sensors import Clock
from insonify.vehicle.settings import VehicleSettings

Waypoint = tuple[Finite, Finite, Finite, Finite]


class MountedSonar(BaseModel):
    """A sonar in its place on the vehicle."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="names its files")
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


class Tour(BaseModel):
    """All that is needed to fly the same tour again."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    world: str = Field(description="a world as `simulate` takes it")
    waypoints: tuple[Waypoint, ...] = Field(
        min_length=2, description="x, y, z (m), heading (degrees); the first is the start"
    )
    seed: int = Field(0, ge=0, lt=2**63)
    vehicle: VehicleSettings = VehicleSettings(name="bluerov2")
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
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


@cache
def suites() -> dict[str, list[Table]]:
    """The named sets of sonars as they stand in ``tours.toml``."""
    text = resources.files("insonify").joinpath("tours.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def tour_config(layers: Iterable[Table]) -> Tour:
    """The settings of a tour from layers; sonars may name a ``preset``, or be a suite's name.

    Raises:
        ConfigError: A setting is unknown, missing or out of range.
    """
    table: Table = {"sonars": "flatfish"}
    for layer in layers:
        table = overlay(table, layer)
    if "world" not in table:
        raise ConfigError(
            "name a world: an SDF world, a mesh, a scenario, tank, grid, or structures"
        )
    if "waypoints" not in table:
        raise ConfigError('say where to fly: --waypoints "X Y Z HEADING; ..." or --path FILE')
    table["vehicle"] = {"name": "bluerov2"} | table.get("vehicle", {})
    if isinstance(table["sonars"], str):
        table["sonars"] = _suite(table["sonars"])
    if isinstance(table["sonars"], list):
        table["sonars"] = [_resolved(one) for one in table["sonars"]]
    try:
        config = Tour.model_validate(table)
    except ValidationError as err:
        raise ConfigError(explain(err, Tour)) from err
    vehicle_named(config.vehicle.name)
    return config


def _suite(name: str) -> list[Table]:
    """The sonars of a suite by name, or of a TOML file with a list ``sonars``."""
    if name in suites():
        return suites()[name]
    path = Path(name)
    if path.suffix != ".toml":
        known = ", ".join(suites())
        raise ConfigError(f"there is no set of sonars named {name!r}; take {known} or a TOML file")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as err:
        raise ConfigError(f"{path}: there is no such file of sonars; check the path") from err
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise ConfigError(f"{path}: cannot be read as TOML ({err})") from err
    sonars = table.get("sonars")
    if not isinstance(sonars, list):
        raise ConfigError(f"{path}: has no list of sonars; begin each with [[sonars]]")
    return sonars


def _resolved(mounted: Any) -> Any:
    """A mounted sonar with its preset's settings below its own."""
    if not isinstance(mounted, dict) or not isinstance(mounted.get("sonar"), dict):
        return mounted
    return mounted | {"sonar": with_preset(mounted["sonar"])}


@dataclass(frozen=True, slots=True, eq=False)
class Sounding:
    """One ping of one sonar.

    Attributes:
        sonar: Its name.
        number: Of this sonar's pings, from 0.
        ping: The image; its geometry's mount is the whole way from the body.
        head_rad: Where a scanning head looked, to the left of its base's ahead.
        true: Where the vehicle was.
        estimated: Where it believed to be.
    """

    sonar: str
    number: int
    ping: Ping
    head_rad: float
    true: Pose
    estimated: Pose


class _Head:
    """A mounted sonar at work."""

    def __init__(self, mounted: MountedSonar, config: Tour, rng: np.random.Generator) -> None:
        self.mounted = mounted
        self._sonar = Sonar(mounted.sonar, config.sampling, config.image)
        self._rng = rng
        self._clock = Clock(mounted.rate_hz)
        self._count = 0

    def listen(self, scene: Scene, craft: Craft) -> Sounding | None:
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
        ping = dataclasses.replace(ping, geometry=whole)
        return Sounding(self.mounted.name, number, ping, head_rad, true, craft.believed_pose)


def tour(
    config: Tour, scene: Scene, pace: Callable[[float], None] = lambda time_s: None
) -> Iterator[Sounding | Craft | StopReason]:
    """Fly the waypoints; all sonars ping all the way.

    Args:
        config: What to fly.
        scene: Its world.
        pace: Called with the time of every tick; it may wait.

    Yields:
        First the vehicle, then each ping as it comes, last why the tour ended.
    """
    vehicle, route = vehicle_named(config.vehicle.name), config.route
    rng = np.random.default_rng([config.seed, 3])
    touches = hull_contact(scene, vehicle.radius_m)
    craft = Craft(vehicle, config.vehicle, route[0], sounder(scene), rng)
    streams = np.random.default_rng([config.seed, 2]).spawn(len(config.sonars))
    heads = [_Head(one, config, own) for one, own in zip(config.sonars, streams, strict=True)]
    looks = Clock(4.0)
    yield craft
    craft.follower.follow(route[1:])
    late_s = 60.0 + 3.0 * route_length_m(route) / config.vehicle.guidance.speed_m_s
    while not craft.follower.finished:
        craft.tick()
        pace(craft.time_s)
        stop = craft.lost
        if looks.due(craft.time_s) and touches(craft.true_pose):
            stop = StopReason.COLLISION
        if craft.time_s > late_s:
            stop = StopReason.TOO_SLOW
        if stop is not None:
            yield stop
            return
        if craft.failed("sonar"):
            continue
        for head in heads:
            sounding = head.listen(scene, craft)
            if sounding is not None:
                yield sounding
    yield StopReason.PLAN_FLOWN


def turns_of(soundings: Iterable[Sounding], mounted: MountedSonar) -> Iterator[list[HeadPing]]:
    """The whole turns of a scanning head, with poses those of its base in the world."""
    steps = len(head_angles(mounted.sonar))
    turn: list[HeadPing] = []
    for one in soundings:
        turn.append(HeadPing(one.ping, one.head_rad, compose(one.true, mounted.place)))
        if len(turn) == steps:
            yield turn
            turn = []
