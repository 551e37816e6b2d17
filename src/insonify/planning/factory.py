"""Planners by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from insonify.planning.active import EntropyPlanner, EntropySettings
from insonify.planning.baselines import LawnmowerPlanner, UniformPlanner
from insonify.planning.decision import Planner, SurveyArea
from insonify.plugins import check_name, load_plugin, made
from insonify.types import FanGeometry

PLANNER_PARTS = ("name", "next_scan")
"""What every planner has."""


@dataclass(frozen=True, slots=True)
class Task:
    """What planners are told: the order, the sonar, and the built-in ones' own settings."""

    area: SurveyArea
    geometry: FanGeometry
    entropy: EntropySettings = EntropySettings()
    baseline_scans: int = 3


PLANNERS: dict[str, Callable[[Task], Planner]] = {
    "entropy": lambda task: EntropyPlanner(task.area, task.geometry, task.entropy),
    "uniform": lambda task: UniformPlanner(task.area, task.baseline_scans),
    "lawnmower": lambda task: LawnmowerPlanner(task.area, task.baseline_scans),
}
FIXED_PLANS = frozenset({"uniform", "lawnmower"})
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
