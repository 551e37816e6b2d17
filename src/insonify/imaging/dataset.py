"""Datasets: many labelled views of a world, from poses drawn at random.

Each view depends on the seed and its number alone, so the first ten of a thousand are the same as
ten, whatever the order or the number of processes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings, Table, validated
from insonify.errors import ConfigError
from insonify.frames import (
    directions_from_angles,
    pose_from_transform,
    rotation_from_rpy,
    transform_from_pose,
)
from insonify.imaging.route import Shot
from insonify.imaging.settings import WorldImaging, world_table
from insonify.scene import Scene
from insonify.seeds import Stream, generator
from insonify.sonar.devices import Kind
from insonify.types import FanGeometry, Float64, Pose, PosedPing, ScanPath

_MOST_DRAWS = 2000
_SEEN_WITHIN = 0.02
"""An aim counts as seen if the ray to it ends within this share of its distance."""


class PoseSettings(Settings):
    """The distribution that poses are drawn from.

    A body is chosen, each as likely as another, and a point on its surface, by area: the aim.  The
    sonar stands off from it by a uniform distance, in a uniform bearing, under a uniform depression
    angle.  The aim lies uniformly within the middle of the fan, in azimuth and elevation; the roll
    is normal.  Drawn again is a pose that is too near to anything, above the surface although its
    aim is below, or from which the aim is hidden.
    """

    look_at: tuple[str, ...] = Field(
        (), description="labels of bodies to aim at; empty: all narrower than half of the world"
    )
    standoff_min_m: float = Field(0.0, ge=0, description="0: a quarter of the sonar's reach")
    standoff_max_m: float = Field(0.0, ge=0, description="0: three quarters of the sonar's reach")
    depression_min_deg: float = Field(5.0, gt=-90, lt=90, description="down to the aim is positive")
    depression_max_deg: float = Field(40.0, gt=-90, lt=90)
    bearing_min_deg: float = Field(-180.0, ge=-360, le=360, description="of the sonar from the aim")
    bearing_max_deg: float = Field(180.0, ge=-360, le=360, description="counted from x to y")
    middle: float = Field(0.6, ge=0, le=1, description="share of the fan in which the aim lies")
    roll_deg: float = Field(2.0, ge=0, le=90, description="standard deviation")
    clearance_m: float = Field(1.0, ge=0, description="least distance to anything")


class Dataset(WorldImaging):
    """All that is needed to make the same dataset again."""

    count: int = Field(100, ge=1, le=1_000_000, description="how many views")
    poses: PoseSettings = PoseSettings()


def dataset_config(world: str, layers: Iterable[Table]) -> Dataset:
    """The settings of a dataset of a world, by name or file, with layers on top.

    Raises:
        ConfigError: A setting is unknown or out of range, or the sonar makes no fans.
    """
    table = world_table(world, layers)
    for key in ("route", "timed", "camera"):  # a named simulation's own
        table.pop(key, None)
    config = validated(Dataset, table)
    if config.sonar.kind not in (Kind.FORWARD_LOOKING, Kind.PROFILING):
        raise ConfigError(
            f"a dataset needs a forward-looking sonar, and {config.sonar.name!r} is a "
            f"{config.sonar.kind} one; see `insonify sonars`"
        )
    settings = config.poses
    for name, low, high in (
        ("standoff", *standoffs_m(config)),
        ("depression", settings.depression_min_deg, settings.depression_max_deg),
        ("bearing", settings.bearing_min_deg, settings.bearing_max_deg),
    ):
        if low > high:
            raise ConfigError(
                f"poses.{name}: its least value, {low:g}, is above its greatest, {high:g}"
            )
    return config


def standoffs_m(config: Dataset) -> tuple[float, float]:
    """Least and greatest distance from the sonar to the aim."""
    reach_m, poses = config.sonar.range_max_m, config.poses
    return poses.standoff_min_m or 0.25 * reach_m, poses.standoff_max_m or 0.75 * reach_m


@dataclass(frozen=True)
class Shots:
    """The views of a dataset, each to be had by its number.

    Attributes:
        config: The settings.
        scene: The world, of `scene.named.named_scene`.
    """

    config: Dataset
    scene: Scene

    @cached_property
    def geometry(self) -> FanGeometry:
        """The fan of every view."""
        return self.config.sonar.geometry

    @cached_property
    def aims(self) -> tuple[int, ...]:
        """Numbers of the bodies that are aimed at.

        Seabeds and walls, those wider than half of the world, only where there is nothing else.

        Raises:
            ConfigError: A label of ``poses.look_at`` is no body's.
        """
        wanted, labels = self.config.poses.look_at, self.scene.labels
        for label in wanted:
            if label not in labels:
                raise ConfigError(
                    f"poses.look_at: there is no body {label!r} in {self.config.world}; choose "
                    f"among {', '.join(labels)}"
                )
        if wanted:
            return tuple(k for k, label in enumerate(labels) if label in wanted)
        widths = [np.ptp(vertices, axis=0).max() for vertices, _ in self.scene.meshes]
        everything = np.concatenate([vertices for vertices, _ in self.scene.meshes])
        narrow = np.asarray(widths) <= np.ptp(everything, axis=0).max() / 2
        if not narrow.any() and len(labels) > 1:
            narrow[:] = True
            narrow[int(np.argmax(widths))] = False
        return tuple(np.flatnonzero(narrow).tolist()) or (0,)

    def shot(self, number: int) -> Shot:
        """A view with its truth, numbers from 0.

        Raises:
            ConfigError: No pose was found that keeps clear and sees its aim.
            RendererError: The renderer cannot be had.
        """
        pose = self.pose(number)
        sonar = self.config.build(self.config.sonar)
        noise = generator(self.config.seed, Stream.DATASET_NOISE, number)
        ping = sonar.ping(self.scene, pose, noise)
        return Shot(number, PosedPing(ping, pose), sonar.truth(self.scene, pose))

    def pose(self, number: int) -> Pose:
        """The vehicle's pose of a view.

        Raises:
            ConfigError: None was found that keeps clear and sees its aim.
        """
        rng = generator(self.config.seed, Stream.DATASET_POSES, number)
        why: Counter[str] = Counter()
        for _ in range(_MOST_DRAWS):
            aim = self._aim(rng)
            sonar_m, pose = self._look(aim, rng)
            problem = self._problem(aim, sonar_m)
            if not problem:
                return pose
            why[problem] += 1
        reasons = ", ".join(f"{count} {reason}" for reason, count in why.most_common())
        raise ConfigError(
            f"view {number}: of {_MOST_DRAWS} poses none would do ({reasons}); change "
            "poses.standoff_min_m, poses.depression_min_deg, poses.clearance_m or poses.look_at"
        )

    def _aim(self, rng: np.random.Generator) -> Float64:
        corners, shares = self._surfaces[int(rng.integers(len(self._surfaces)))]
        face = min(int(np.searchsorted(shares, rng.random(), side="right")), len(corners) - 1)
        u, v = math.sqrt(rng.random()), rng.random()
        a, b, c = corners[face]
        point: Float64 = (1.0 - u) * a + u * (1.0 - v) * b + u * v * c
        return point

    @cached_property
    def _surfaces(self) -> list[tuple[Float64, Float64]]:
        """Corners (faces, 3, 3) of each body that is aimed at, and its areas summed up to 1."""
        found = []
        for body in self.aims:
            vertices, faces = self.scene.meshes[body]
            corners = np.asarray(vertices, np.float64)[faces]
            sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            areas = np.linalg.norm(sides, axis=1)
            found.append((corners, np.cumsum(areas) / areas.sum()))
        return found

    def _look(self, aim: Float64, rng: np.random.Generator) -> tuple[Float64, Pose]:
        """A pose that looks at an aim, and where the sonar is then."""
        settings, fan = self.config.poses, self.geometry
        standoff_m = rng.uniform(*standoffs_m(self.config))
        bearing = math.radians(rng.uniform(settings.bearing_min_deg, settings.bearing_max_deg))
        depression = math.radians(
            rng.uniform(settings.depression_min_deg, settings.depression_max_deg)
        )
        half_az, half_el = fan.azimuth_fov_rad / 2, fan.elevation_fov_rad / 2
        azimuth = settings.middle * rng.uniform(-half_az, half_az)
        elevation = settings.middle * rng.uniform(-half_el, half_el)
        roll = math.radians(settings.roll_deg) * rng.standard_normal()
        away = directions_from_angles(np.array([bearing]), np.array([depression]))[0]
        sonar_m = aim + standoff_m * away
        seen = directions_from_angles(np.array([azimuth]), np.array([elevation]))[0]
        turn = np.eye(4)
        turn[:3, :3] = _turn_towards(seen, roll, depression, bearing + math.pi)
        turn[:3, 3] = sonar_m
        body_from_sonar = transform_from_pose(fan.mount)
        return sonar_m, pose_from_transform(turn @ np.linalg.inv(body_from_sonar))

    def _problem(self, aim: Float64, sonar_m: Float64) -> str:
        """What is wrong with a place, or nothing."""
        if sonar_m[2] >= 0.0 > aim[2]:
            return "above the surface"
        standoff_m = float(np.linalg.norm(aim - sonar_m))
        towards = ((aim - sonar_m) / standoff_m).astype(np.float32)[None, :]
        if self.scene.cast(sonar_m, towards).range_m[0] < (1.0 - _SEEN_WITHIN) * standoff_m:
            return "with the aim hidden"
        here = ScanPath((Pose(*map(float, sonar_m)),))
        if self.scene.first_collision(here, self.config.poses.clearance_m) is not None:
            return "too near to something"
        return ""


def _turn_towards(seen: Float64, roll: float, depression: float, heading: float) -> Float64:
    """The rotation of a sonar of some roll that sees in direction ``seen`` what lies ahead.

    With v = Rx(roll) seen, the pitch p solves -v_x sin p + v_z cos p = -sin(depression), and the
    yaw brings the rest to the heading.
    """
    v = rotation_from_rpy(roll, 0.0, 0.0) @ seen
    reach, phase = math.hypot(v[0], v[2]), math.atan2(v[0], v[2])
    pitch = math.acos(min(1.0, max(-1.0, -math.sin(depression) / reach))) - phase
    level = rotation_from_rpy(roll, pitch, 0.0)
    ahead = level @ seen
    return rotation_from_rpy(roll, pitch, heading - math.atan2(ahead[1], ahead[0]))
