"""The views of a dataset from all of its worlds, with one list of labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from insonify.errors import ConfigError
from insonify.imaging.dataset import PARTS, Dataset, Shots
from insonify.imaging.route import Shot
from insonify.types import FanGeometry


class Collection:
    """The views of a dataset, each to be had by its number.

    Attributes:
        config: The settings.
        labels: The bodies of all worlds, in the order in which the worlds have them.
    """

    def __init__(self, config: Dataset, labels: tuple[str, ...] | None = None) -> None:
        """A collection of which no world is kept in memory but the last one used.

        Args:
            config: The settings.
            labels: Of another collection of the same settings, so that no world is looked through.

        Raises:
            WorldError: A world's file cannot be used.
            ConfigError: There is no such world, no body to look at, or no pose to look from.
        """
        self.config = config
        self._shots = lru_cache(maxsize=1)(self._made)
        self.labels = self._found() if labels is None else labels
        for label in config.poses.look_at if config.more_worlds else ():
            if label not in self.labels:
                raise ConfigError(
                    f"poses.look_at: there is no body {label!r} in any of the worlds; choose among "
                    f"{', '.join(self.labels)}"
                )

    @property
    def geometry(self) -> FanGeometry:
        """The fan of every view."""
        return self.config.sonar.geometry

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts that have worlds, in the order of `PARTS`."""
        return tuple(part for part in PARTS if part in self.config.parts)

    def world(self, number: int) -> int:
        """Number of the world that a view is of."""
        return number % len(self.config.worlds)

    def part(self, number: int) -> str:
        """The part that a view is in."""
        return self.config.parts[self.world(number)]

    def numbers(self, part: str) -> Iterator[int]:
        """The views of a part."""
        parts = self.config.parts
        return (k for k in range(self.config.count) if parts[k % len(parts)] == part)

    def by_world(self, numbers: Iterable[int]) -> list[int]:
        """Views so ordered that those of one world follow each other."""
        return sorted(numbers, key=lambda number: (self.world(number), number))

    def shot(self, number: int) -> Shot:
        """A view with its truth, in `labels`, numbers from 0.

        Raises:
            ConfigError: No pose was found that keeps clear and sees its aim.
            RendererError: The renderer cannot be had.
        """
        shot = self._shots(self.world(number)).shot(number)
        truth = shot.truth
        assert truth is not None
        renamed = np.array([self.labels.index(label) for label in truth.labels] + [-1], np.int32)
        return replace(shot, truth=replace(truth, labels=self.labels, label=renamed[truth.label]))

    def _made(self, world: int) -> Shots:
        alone = self.config.of_world(world, ())
        scene = alone.scene()
        return Shots(self.config.of_world(world, scene.labels), scene)

    def _found(self) -> tuple[str, ...]:
        """The labels; found out on the way, before any work, is whether a pose can be had."""
        labels: dict[str, None] = {}
        for world in range(min(len(self.config.worlds), self.config.count)):
            shots = self._shots(world)
            shots.pose(world)  # the first view of each world has its number
            labels |= dict.fromkeys(shots.scene.labels)
        return tuple(labels)
