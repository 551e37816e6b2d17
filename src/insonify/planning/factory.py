"""Planners by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from insonify.planning.active import EntropyPlanner, EntropySettings
from insonify.planning.baselines import LawnmowerPlanner, UniformPlanner, near_area
from insonify.planning.decision import Planner, SurveyArea
from insonify.planning.information import InformationPlanner, InformationSettings
from insonify.planning.rosette import RosettePlanner, RosetteSettings
from insonify.plugins import check_name, load_plugin, made
from insonify.types import FanGeometry

PLANNER_PARTS = ("name", "next_scan")
"""What every planner has."""


@dataclass(frozen=True, slots=True)
class Task:
    """What planners are told: the order, the sonar, and the built-in ones' own settings.

    Attributes:
        area: The order.
        geometry: The sonar.
        entropy: Settings of `entropy`.
        rosette: Settings of `rosette`.
        information: Settings of `information`.
        baseline_scans: How many scans the fixed plans fly.
        mapper: Name of the mapper, which says how high it wants the sonar.
        clearance_m: Least distance of the vehicle to anything.
    """

    area: SurveyArea
    geometry: FanGeometry
    entropy: EntropySettings = EntropySettings()
    rosette: RosetteSettings = RosetteSettings()
    information: InformationSettings = InformationSettings()
    baseline_scans: int = 3
    mapper: str = "bayes"
    clearance_m: float = 0.4

    @property
    def least_altitude_m(self) -> float:
        """Height above the seabed that suits the mapper."""
        return _LEAST_ALTITUDE_M.get(self.mapper, 0.0)

    @property
    def near(self) -> SurveyArea:
        """The order as a careful pilot would have it."""
        return near_area(self.area, self.geometry, self.least_altitude_m)


_LEAST_ALTITUDE_M = {"carving": 5.2}
"""Bayes maps best low, where an arc of the fan is short; carving where rays come down steeply."""
PLANNERS: dict[str, Callable[[Task], Planner]] = {
    "entropy": lambda task: EntropyPlanner(task.area, task.geometry, task.entropy),
    "uniform": lambda task: UniformPlanner(task.area, task.baseline_scans),
    "lawnmower": lambda task: LawnmowerPlanner(task.area, task.baseline_scans),
    "uniform-near": lambda task: UniformPlanner(task.near, task.baseline_scans, "uniform-near"),
    "lawnmower-near": lambda task: LawnmowerPlanner(
        task.near, task.baseline_scans, "lawnmower-near"
    ),
    "rosette": lambda task: RosettePlanner(
        task.area, task.geometry, task.rosette, task.least_altitude_m
    ),
    "information": lambda task: InformationPlanner(
        task.area, task.geometry, task.information, task.least_altitude_m, task.clearance_m
    ),
}
COMPARED = ("entropy", "uniform", "uniform-near", "lawnmower", "lawnmower-near")
"""The planners of Park et al. 2025, its baselines also as a careful pilot would fly them."""
FIXED_PLANS = frozenset({"uniform", "lawnmower", "uniform-near", "lawnmower-near"})
"""Those that fly as many scans as they are told."""


def make_planner(name: str, task: Task, options: Mapping[str, Any] | None = None) -> Planner:
    """A planner for a task.

    Args:
        name: Of one of `PLANNERS`, or a user's own: ``module:Name`` or ``file.py:Name``, which is
            made with the area and the sonar's geometry.
        task: What is to be scanned with what.
        options: Of a user's own, by keyword.

    Raises:
        ConfigError: There is none of that name, or it is no planner.
    """
    check_planner(name, options)
    if name in PLANNERS:
        return PLANNERS[name](task)
    factory, given = load_plugin(name, "planner"), (task.area, task.geometry)
    planner: Planner = made(factory, name, "planner", given, options or {}, PLANNER_PARTS)
    return planner


def check_planner(name: str, options: Mapping[str, Any] | None = None) -> None:
    """Refuse a name that is neither of `PLANNERS` nor a user's own.

    Raises:
        ConfigError: It is neither, or a known one is given options.
    """
    check_name("planner", name, PLANNERS, options)
