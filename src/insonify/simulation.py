"""A sonar simulated along a route through a world: the settings, and what comes out of them.

``simulate`` yields records as the mission does; writing and showing them is done outside.
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
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from insonify.errors import ConfigError
from insonify.frames import pose_at
from insonify.scenarios import Table, World, explain, overlay, scenario_config, scenarios
from insonify.scene import Scene
from insonify.scene.experiments import EXPERIMENTS
from insonify.scene.materials import Material
from insonify.scene.worlds import load_scene
from insonify.sonar import RendererName, Sonar, renderer_named
from insonify.sonar.camera import Camera, CameraSettings, Picture
from insonify.sonar.devices import Kind, SonarDevice, with_preset
from insonify.sonar.formation import ImageSettings
from insonify.sonar.physical import PhysicalSettings
from insonify.sonar.sampling import SamplingSettings
from insonify.sonar.scanning import (
    SIDES_RAD,
    HeadPing,
    deskewed_image,
    head_angles,
    polar_image,
    sidescan_line,
    soundings,
    sweep,
)
from insonify.sonar.truth import Truth
from insonify.sonar.water import WaterSettings
from insonify.types import Float32, Float64, Ping, Pose, Trajectory

Row = tuple[float, float, float, float, float, float, float]


class Imaging(BaseModel):
    """What is looked at, and with what sonar: the settings that every simulated image needs."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = ""
    world: str = Field(description="tank, grid, structures, a scenario, an SDF world, or a mesh")
    seed: int = Field(0, ge=0, lt=2**63)
    model: Literal["cerqueira", "physical"] = "cerqueira"
    renderer: RendererName = Field(RendererName.EMBREE, description="embree or opengl")
    sonar: SonarDevice = SonarDevice()
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
    physical: PhysicalSettings = PhysicalSettings()
    water: WaterSettings = WaterSettings()


class Simulation(Imaging):
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


@cache
def simulations() -> dict[str, Table]:
    """The named simulations as they stand in ``simulations.toml``."""
    text = resources.files("insonify").joinpath("simulations.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def simulation_config(world: str, layers: Iterable[Table]) -> Simulation:
    """The settings of a named simulation, or of a world, with layers on top.

    A layer's ``sonar`` may name a ``preset``; other settings of the same table change it.

    Raises:
        ConfigError: A setting is unknown or out of range, or the route is missing.
    """
    table = imaging_table(world, layers)
    if "route" not in table:
        raise ConfigError(
            'say where the sonar is: --pose "x y z roll pitch yaw", --path FILE or --orbit'
        )
    try:
        return Simulation.model_validate(table)
    except ValidationError as err:
        raise ConfigError(explain(err, Simulation)) from err


def imaging_table(world: str, layers: Iterable[Table]) -> Table:
    """The settings of a named simulation, or of a world, with layers on top, not yet checked."""
    table: Table = dict(simulations().get(world, {"world": world}))
    table["sonar"] = _device(table.get("sonar", {}))
    for layer in layers:
        inner = layer.get("sonar")
        if isinstance(inner, dict) and "preset" in inner:
            table["sonar"] = _device(inner)
            layer = {key: value for key, value in layer.items() if key != "sonar"}
        table = overlay(table, layer)
    return table


def _device(table: Table) -> Table:
    """A device's settings; those of its preset, if it names one, below them."""
    return with_preset(table) if "preset" in table else {"tilt_deg": 0.0} | table


def build_scene(
    world: str, search: Iterable[Path] = (), materials: dict[str, Material] | None = None
) -> Scene:
    """The scene of a world by name or file.

    Raises:
        WorldError: The file cannot be used.
        ConfigError: There is no such name or file.
    """
    if world in EXPERIMENTS:
        return EXPERIMENTS[world]()
    if world in scenarios():
        return World(scenario_config(world)).scene
    path = Path(world)
    if not path.exists():
        names = ", ".join([*EXPERIMENTS, *scenarios(), *simulations()])
        raise ConfigError(f"{world}: there is no such world or mesh file, nor is it one of {names}")
    return load_scene(path, search=tuple(search), materials=materials)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A ping of a fan, and what was asked for beside it."""

    number: int
    ping: Ping
    pose: Pose
    truth: Truth | None = None
    picture: Picture | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A turn of a scanning head: raw pings, side by side, and de-skewed to the first pose."""

    number: int
    pings: tuple[HeadPing, ...]
    polar: Ping
    deskewed: Ping
    truths: tuple[Truth, ...] = ()
    picture: Picture | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of a side-scan image: its two pings, port first."""

    number: int
    port: Ping
    starboard: Ping
    pose: Pose
    truths: tuple[Truth, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A ping of a profiling sonar and its soundings, (N, 3) world frame."""

    view: View
    points: Float64


Record = View | Turn | Line | Profile


def simulate(
    config: Simulation, scene: Scene, *, with_truth: bool = False, camera: Camera | None = None
) -> Iterator[Record]:
    """Ping along the route.

    Args:
        config: What to simulate.
        scene: Its world, of `build_scene`.
        with_truth: The truth of each pixel too.
        camera: Takes a picture along the sonar's axis, if one is wanted.

    Raises:
        RendererError: The renderer cannot be had.
        ConfigError: A camera is asked for beside a side-scan, which looks to both sides.
    """
    if camera is not None and config.sonar.kind is Kind.SIDESCAN:
        raise ConfigError("a side-scan sonar looks to both sides; leave --camera out")
    sonar = build_sonar(config)
    rng = np.random.default_rng([config.seed, 2])
    kind, device = config.sonar.kind, config.sonar

    def ping(pose: Pose, head_rad: float, time_s: float) -> Ping:
        return sonar.ping(scene, pose, rng, head_rad=head_rad, time_s=time_s)

    def truth(pose: Pose, head_rad: float = 0.0) -> Truth | None:
        return sonar.truth(scene, pose, head_rad=head_rad) if with_truth else None

    def picture(pose: Pose) -> Picture | None:
        if camera is None:
            return None
        tilted = dataclasses.replace(pose, pitch_rad=pose.pitch_rad + math.radians(device.tilt_deg))
        return camera.take(scene, tilted)

    if kind is Kind.SCANNING:
        yield from _turns(config, ping, truth, picture)
        return
    for number, (time_s, pose) in enumerate(ping_times(config)):
        if kind is Kind.SIDESCAN:
            port, starboard = (ping(pose, side, time_s) for side in SIDES_RAD)
            truths = tuple(t for side in SIDES_RAD if (t := truth(pose, side)) is not None)
            yield Line(number, port, starboard, pose, truths)
            continue
        view = View(number, ping(pose, 0.0, time_s), pose, truth(pose), picture(pose))
        if kind is Kind.PROFILING:
            yield Profile(view, soundings(view.ping, pose, config.image.noise * 5 + 0.05))
        else:
            yield view


def build_sonar(config: Imaging) -> Sonar:
    """The sonar that the settings describe.

    Raises:
        RendererError: The renderer cannot be had.
    """
    return Sonar(
        config.sonar,
        config.sampling,
        config.image,
        renderer_named(config.renderer, config.sampling),
        config.physical if config.model == "physical" else None,
        config.water,
    )


def ping_times(config: Simulation) -> list[tuple[float, Pose]]:
    """When and where a sonar that is no scanning one pings along the route."""
    trajectory = config.trajectory
    if not config.timed or len(trajectory.poses) == 1:
        return list(zip(trajectory.times_s, trajectory.poses, strict=True))
    interval_s = config.sonar.interval_s(config.water.sound_speed_mps)
    start_s = trajectory.times_s[0]
    count = math.floor((trajectory.end_s - start_s) / interval_s + 1e-9) + 1
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
    count = max(1, math.floor(span_s / turn_s + 1e-6))
    return [
        (trajectory.times_s[0] + k * turn_s, lambda time_s: pose_at(trajectory, time_s))
        for k in range(count)
    ]


def _turns(
    config: Simulation,
    ping: Callable[[Pose, float, float], Ping],
    truth: Callable[[Pose, float], Truth | None],
    picture: Callable[[Pose], Picture | None],
) -> Iterator[Turn]:
    for number, (start_s, where) in enumerate(turn_starts(config)):
        pings = tuple(
            sweep(
                ping, config.sonar, where, start_s=start_s, number=number,
                sound_speed_mps=config.water.sound_speed_mps,
            )
        )  # fmt: skip
        truths = tuple(t for one in pings if (t := truth(one.pose, one.head_rad)) is not None)
        yield Turn(
            number,
            pings,
            polar_image(pings, config.sonar),
            deskewed_image(pings, config.sonar, pings[0].pose),
            truths,
            picture(pings[0].pose),
        )


def waterfall(lines: list[Line]) -> Float32:
    """The lines of a side-scan image, (lines, 2 x bins), port on the left, the first line below."""
    return np.stack([sidescan_line(line.port, line.starboard) for line in lines[::-1]])


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
