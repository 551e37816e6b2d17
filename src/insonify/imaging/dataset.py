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
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from insonify.config.layers import named_tables
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

PARTS = ("train", "val", "test")
Format = Literal["yolo", "webdataset"]
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
    """All that is needed to make the same dataset again.

    View k is of world k modulo the number of worlds.  A world is in one part alone: what a network
    is tested on, it has not been trained on from another side.
    """

    more_worlds: tuple[str, ...] = Field((), description="worlds beside it; views of each in turn")
    count: int = Field(100, ge=1, le=1_000_000, description="how many views")
    split: tuple[float, ...] = Field(
        (), description="shares of worlds for train, val and test; empty: val and test name theirs"
    )
    val: tuple[str, ...] = Field((), description="worlds for validation")
    test: tuple[str, ...] = Field((), description="worlds for testing")
    formats: tuple[Format, ...] = Field((), description="beside Zarr and COCO: yolo, webdataset")
    license: str = Field("", description="cc-by-4.0 or another name, or a text file")
    poses: PoseSettings = PoseSettings()

    @property
    def worlds(self) -> tuple[str, ...]:
        """All worlds."""
        return (self.world, *self.more_worlds)

    @property
    def names(self) -> tuple[str, ...]:
        """What to call them: the stems of files, told apart by a number where they are the same."""
        stems = [Path(world).stem for world in self.worlds]
        return tuple(
            f"{stem}-{stems[:k].count(stem) + 1}" if stem in stems[:k] else stem
            for k, stem in enumerate(stems)
        )

    @property
    def parts(self) -> tuple[str, ...]:
        """The part that each world is in, a name of `PARTS`."""
        if not self.split:
            told = dict.fromkeys(self.val, "val") | dict.fromkeys(self.test, "test")
            return tuple(told.get(world, "train") for world in self.worlds)
        counts = _worlds_a_part(self.split, len(self.worlds))
        assert counts is not None
        drawn = np.repeat(np.arange(len(PARTS)), counts)
        generator(self.seed, Stream.DATASET_SPLIT).shuffle(drawn)
        return tuple(PARTS[k] for k in drawn)

    def of_world(self, number: int, labels: Iterable[str]) -> Dataset:
        """The same of one of the worlds, whose bodies have these labels."""
        if not self.more_worlds:
            return self
        aims = tuple(label for label in self.poses.look_at if label in labels)
        poses = self.poses.model_copy(update={"look_at": aims or self.poses.look_at})
        alone: dict[str, object] = {"more_worlds": (), "split": (), "val": (), "test": ()}
        return self.model_copy(update=alone | {"world": self.worlds[number], "poses": poses})


def _worlds_a_part(shares: tuple[float, ...], worlds: int) -> list[int] | None:
    """How many of some worlds each of `PARTS` gets by its share; None if they are too few."""
    counts = [max(1, round(worlds * share / sum(shares))) if share else 0 for share in shares]
    counts[0] = worlds - sum(counts[1:])
    return counts if counts[0] > 0 else None


def _check_parts(config: Dataset) -> None:
    """Refuse parts that cannot be.

    Raises:
        ConfigError: A world is named twice, is not there or in two parts, or is wanted for two.
    """
    worlds, split = config.worlds, config.split
    for world in worlds:
        if worlds.count(world) > 1:
            raise ConfigError(f"{world}: is named twice; name each world once")
    if split:
        told = "/".join(f"{share:g}" for share in split)
        if (
            len(split) != len(PARTS)
            or min(split) < 0
            or not split[0]
            or not all(map(math.isfinite, split))
        ):
            raise ConfigError(
                f"split: three shares for train, val and test, as 80/10/10, not {told}"
            )
        if config.val or config.test:
            raise ConfigError("split: draws the worlds for val and test, so name none yourself")
        if _worlds_a_part(split, len(worlds)) is None:
            raise ConfigError(
                f"split: {told} of {len(worlds)} "
                f"{'world' if len(worlds) == 1 else 'worlds'} leaves none to train on, as no world "
                f"is in two parts; name more worlds, as in: field@0 field@1 field@2"
            )
    for part, named in (("val", config.val), ("test", config.test)):
        for world in named:
            if world not in worlds:
                raise ConfigError(f"{part}: {world!r} is none of the worlds, {', '.join(worlds)}")
    both = set(config.val) & set(config.test)
    if both:
        raise ConfigError(f"val and test: {', '.join(sorted(both))} is in both; a world is in one")
    if not set(worlds) - set(config.val) - set(config.test):
        raise ConfigError("val and test: leave no world to train on; name more worlds")


def dataset_config(world: str, layers: Iterable[Table]) -> Dataset:
    """The settings of a dataset of a world, by name or file, with layers on top.

    Raises:
        ConfigError: A setting is unknown or out of range, or the sonar makes no fans.
    """
    table = world_table(world, layers)
    for key in ("route", "timed", "camera"):  # a named simulation's own
        table.pop(key, None)
    simulations = named_tables("simulations")
    for key in ("more_worlds", "val", "test"):
        if isinstance(table.get(key), list | tuple):
            table[key] = [simulations.get(str(one), {}).get("world", one) for one in table[key]]
    config = validated(Dataset, table)
    _check_parts(config)
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
