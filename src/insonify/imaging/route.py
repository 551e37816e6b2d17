"""A sonar simulated along a route through a world: the settings, and what comes out of them.

``simulate`` yields records as the mission does; writing and showing them is done outside.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from insonify.config.settings import Table, validated
from insonify.errors import ConfigError
from insonify.frames import pose_at
from insonify.imaging.settings import WorldImaging, world_table
from insonify.limits import MOST_ROUTE_PINGS
from insonify.scene import Scene
from insonify.seeds import Stream, generator
from insonify.sonar import Sonar
from insonify.sonar.camera import Camera, CameraSettings, Picture
from insonify.sonar.devices import Kind
from insonify.sonar.scanning import (
    SIDES_RAD,
    deskewed_image,
    head_angles,
    polar_image,
    soundings,
    sweep,
)
from insonify.sonar.truth import Truth
from insonify.types import Float64, Ping, Pose, PosedPing, Trajectory

Row = tuple[float, float, float, float, float, float, float]


class Simulation(WorldImaging):
    """All that is needed to simulate the same images again."""

    route: tuple[Row, ...] = Field(
        min_length=1, description="time_s, x, y, z (m), roll, pitch, yaw (degrees)"
    )
    timed: bool = Field(
        True, description="ping at the device's rate along the route; false: once at each row"
    )
    camera: CameraSettings = CameraSettings()

    @property
    def trajectory(self) -> Trajectory:
        """The route with its angles in radians."""
        poses = tuple(
            Pose(x, y, z, math.radians(roll), math.radians(pitch), math.radians(yaw))
            for _, x, y, z, roll, pitch, yaw in self.route
        )
        return Trajectory(tuple(row[0] for row in self.route), poses)


def simulation_config(world: str, layers: Iterable[Table]) -> Simulation:
    """The settings of a named simulation, or of a world, with layers on top.

    A layer's ``sonar`` may name a ``preset``; other settings of the same table change it.

    Raises:
        ConfigError: A setting is unknown or out of range, or the route is missing.
    """
    table = world_table(world, layers)
    if "route" not in table:
        raise ConfigError(
            'say where the sonar is: --pose "x y z roll pitch yaw", --path FILE or --orbit'
        )
    return validated(Simulation, table)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A ping of a fan, and what was asked for beside it.

    Attributes:
        number: From 0.
        posed: The ping, and where it was taken.
        truth: What each pixel shows.
        picture: A camera's, along the sonar's axis.
    """

    number: int
    posed: PosedPing
    truth: Truth | None = None
    picture: Picture | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A turn of a scanning head: raw pings, side by side, and de-skewed to the first pose."""

    number: int
    pings: tuple[PosedPing, ...]
    polar: Ping
    deskewed: Ping
    truths: tuple[Truth, ...] = ()
    picture: Picture | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of a side-scan image: its two pings, port first."""

    number: int
    port: PosedPing
    starboard: PosedPing
    truths: tuple[Truth, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A ping of a profiling sonar and its soundings, (N, 3) world frame."""

    shot: Shot
    points: Float64


Record = Shot | Turn | Line | Profile


def simulate(
    config: Simulation, scene: Scene, *, with_truth: bool = False, camera: Camera | None = None
) -> Iterator[Record]:
    """Ping along the route.

    Args:
        config: What to simulate.
        scene: Its world, of `scene.named.named_scene`.
        with_truth: The truth of each pixel too.
        camera: Takes a picture along the sonar's axis, if one is wanted.

    Raises:
        RendererError: The renderer cannot be had.
        ConfigError: A camera is asked for beside a side-scan, which looks to both sides.
    """
    if camera is not None and config.sonar.kind is Kind.SIDESCAN:
        raise ConfigError("a side-scan sonar looks to both sides; leave --camera out")
    yield from _Simulator(config, scene, with_truth, camera).records()


@dataclass(slots=True, eq=False)
class _Simulator:
    """The sonar in its world, with what is asked for beside its pings."""

    config: Simulation
    scene: Scene
    with_truth: bool
    camera: Camera | None
    sonar: Sonar = dataclasses.field(init=False)
    noise: np.random.Generator = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        self.sonar = self.config.build(self.config.sonar)
        self.noise = generator(self.config.seed, Stream.NOISE)

    def records(self) -> Iterator[Record]:
        """Of the sonar's kind."""
        kind = self.config.sonar.kind
        if kind is Kind.SCANNING:
            yield from self._turns()
            return
        where = ping_times(self.config)
        heads = SIDES_RAD if kind is Kind.SIDESCAN else (0.0,)
        pings = self._pings([(pose, head, time_s) for time_s, pose in where for head in heads])
        for number, (_, pose) in enumerate(where):
            posed = next(pings)
            if kind is Kind.SIDESCAN:
                yield Line(number, posed, next(pings), self._truths(pose, SIDES_RAD))
                continue
            truth = next(iter(self._truths(pose, (0.0,))), None)
            shot = Shot(number, posed, truth, self._picture(pose))
            if kind is Kind.PROFILING:
                threshold = self.config.image.noise * 5 + 0.05
                yield Profile(shot, soundings(posed, threshold))
            else:
                yield shot

    def _turns(self) -> Iterator[Turn]:
        device = self.config.sonar
        speed = self.config.water.sound_speed_mps
        for number, (start_s, where) in enumerate(turn_starts(self.config)):
            moments = sweep(device, where, start_s=start_s, number=number, sound_speed_mps=speed)
            pings = tuple(self._pings(moments))
            first = where(start_s)
            yield Turn(
                number,
                pings,
                polar_image(pings, device),
                deskewed_image(pings, device, first),
                tuple(
                    truth
                    for one in pings
                    if one.pose is not None
                    for truth in self._truths(one.pose, (one.ping.head_rad,))
                ),
                self._picture(first),
            )

    def _pings(self, moments: list[tuple[Pose, float, float]]) -> Iterator[PosedPing]:
        """Pings from poses, with the head turned so, at these times."""
        poses, heads_rad, times_s = zip(*moments, strict=True)
        pings = self.sonar.pings(
            self.scene, poses, self.noise, heads_rad=heads_rad, times_s=times_s
        )
        return map(PosedPing, pings, poses)

    def _truths(self, pose: Pose, heads_rad: Iterable[float]) -> tuple[Truth, ...]:
        if not self.with_truth:
            return ()
        return tuple(self.sonar.truth(self.scene, pose, head_rad=head) for head in heads_rad)

    def _picture(self, pose: Pose) -> Picture | None:
        if self.camera is None:
            return None
        tilt_rad = math.radians(self.config.sonar.tilt_deg)
        tilted = dataclasses.replace(pose, pitch_rad=pose.pitch_rad + tilt_rad)
        return self.camera.take(self.scene, tilted)


def ping_times(config: Simulation) -> list[tuple[float, Pose]]:
    """When and where a sonar that is no scanning one pings along the route."""
    trajectory = config.trajectory
    if not config.timed or len(trajectory.poses) == 1:
        return list(zip(trajectory.times_s, trajectory.poses, strict=True))
    interval_s = config.sonar.interval_s(config.water.sound_speed_mps)
    start_s = trajectory.times_s[0]
    count = _count((trajectory.end_s - start_s) / interval_s + 1e-9) + 1
    times = [start_s + k * interval_s for k in range(count)]
    return [(time_s, pose_at(trajectory, time_s)) for time_s in times]


def turn_starts(config: Simulation) -> list[tuple[float, Callable[[float], Pose]]]:
    """When the turns of a scanning head begin, and where the vehicle is from then on."""
    trajectory = config.trajectory
    if not config.timed:
        return [
            (time_s, lambda _, rests=pose: rests)  # type: ignore[misc]
            for time_s, pose in zip(trajectory.times_s, trajectory.poses, strict=True)
        ]
    interval_s = config.sonar.interval_s(config.water.sound_speed_mps)
    turn_s = len(head_angles(config.sonar)) * interval_s
    span_s = trajectory.end_s - trajectory.times_s[0]
    count = max(1, _count(span_s / turn_s + 1e-6))
    return [
        (trajectory.times_s[0] + k * turn_s, lambda time_s: pose_at(trajectory, time_s))
        for k in range(count)
    ]


def _count(pings: float) -> int:
    """How many pings, or turns, a route takes.

    Raises:
        ConfigError: More than `insonify.limits` allows.
    """
    if not pings <= MOST_ROUTE_PINGS:
        raise ConfigError(
            f"the route takes so long that there would be {pings:.3g} pings, more than "
            f"{MOST_ROUTE_PINGS:,}; check its times, or let the sonar ping less often "
            "(--set sonar.rate_hz=...)"
        )
    return math.floor(pings)


def orbit(
    centre_m: tuple[float, float], z_m: float, radius_m: float, count: int, pitch_deg: float
) -> tuple[Row, ...]:
    """Poses evenly around an axis, all looking at it, a second apart."""
    rows: list[Any] = []
    for k in range(count):
        angle = math.tau * k / count
        x, y = centre_m[0] + radius_m * math.cos(angle), centre_m[1] + radius_m * math.sin(angle)
        yaw = math.degrees(math.remainder(angle + math.pi, math.tau))
        rows.append((float(k), x, y, z_m, 0.0, pitch_deg, yaw))
    return tuple(rows)
