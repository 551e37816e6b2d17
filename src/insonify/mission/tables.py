"""The runs of a campaign as flat tables, and what follows from them over the seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from insonify.config.settings import Table
from insonify.display import Told
from insonify.mission.campaign import FACTORS, factors
from insonify.mission.result import ScanResult, flat
from insonify.mission.setup import Config
from insonify.mission.statistics import holm, interval, mean_height, paired_p

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADLINE = "solid_exact_f1"
"""The score that is drawn and tested unless another is asked for."""
SETTING = ("scenario", "sonar", "model", "navigation")
"""Within one of these, curves can be drawn over each other."""
AREAS = {"area_path": "path_m", "area_pings": "pings", "area_time": "time_s"}
"""What scores are drawn against, and the columns of the areas under those curves."""
_NO_SCORES = {
    "run",
    *FACTORS,
    "scan",
    "scans",
    *AREAS.values(),
    "total_entropy_bits",
    "ghosts",
    "stop_reason",
}
_OF_THE_VEHICLE = ("pose_error_", "true_poses_")


@dataclass(frozen=True, slots=True, eq=False)
class Campaign(Told):
    """The results of a campaign.

    Attributes:
        title: Its own.
        runs: pandas DataFrame, one row a run: its key (``run``), the `FACTORS`, scans, pings,
            path_m, time_s, every score at its end, why it stopped, and a vehicle's errors.
        curves: pandas DataFrame, one row for each moment at which a run's map was scored.
        seconds: pandas DataFrame, wall time by run, which alone differs each time.
        failed: Runs without a result: their `FACTORS`, ``message`` and ``traceback``.
    """

    title: str
    runs: Any
    curves: Any
    seconds: Any
    failed: tuple[Table, ...]

    def plot(
        self,
        axes: Axes | None = None,
        *,
        score: str = HEADLINE,
        along: str = "path_m",
        **setting: str,
    ) -> Axes:
        """Draw a score against what was spent: means over the seeds with 95 % bands.

        Args:
            axes: Where; by default those of a new figure, which notebooks show.
            score: A column of ``curves``.
            along: ``path_m``, ``pings`` or a vehicle's ``time_s``.
            setting: Which of several settings (``scenario``, ``sonar``, ``model``,
                ``navigation``), as in ``scenario="wreck"``: curves of others do not compare.

        Returns:
            The axes.

        Raises:
            ResultError: There is no such score or setting, or more than one.
            MissingExtraError: matplotlib is not installed.
        """  # fmt: skip
        return self._plotted(axes, score=score, along=along, setting=setting)


def curve_rows(key: str, config: Config, result: ScanResult) -> list[Table]:
    """A run's moments, each a flat row; scores by their whole name, as in ``solid_exact_f1``."""
    named = {"run": key, **factors(config)}
    return [
        named
        | {"scan": row.scan, "pings": row.pings, "path_m": row.path_m, "time_s": row.time_s}
        | {"total_entropy_bits": row.total_entropy_bits, "ghosts": row.ghosts}
        | dict(flat("", row.metrics))
        for row in result.history
    ]


def run_row(key: str, config: Config, result: ScanResult) -> Table:
    """A run's end as one flat row."""
    last = curve_rows(key, config, result)[-1]
    row = {"scans" if name == "scan" else name: value for name, value in last.items()}
    row["stop_reason"] = result.stop_reason.value
    if result.vehicle is not None:
        row["time_s"] = result.vehicle.time_s
        row |= flat("pose_error_", result.vehicle.pose_error)
        row |= flat("true_poses_", result.vehicle.metrics_at_true_poses)
    return row


def short(name: str) -> str:
    """A name for people: of a user's own part, what follows the file or module."""
    return name.rpartition(":")[2]


def scores(table: Any) -> list[str]:
    """The columns that are scores of the map, whatever there are."""
    return [
        name
        for name in table.columns
        if name not in _NO_SCORES and not name.startswith(_OF_THE_VEHICLE)
    ]


def areas(curves: Any, score: str = HEADLINE, along: str = "path_m") -> dict[str, float]:
    """The mean height of each run's curve, by run: how much was known how early.

    All runs of one setting are measured up to where the longest of them ends; a run that ended
    before keeps what it had.  `statistics.height_at` has the curve.
    """
    found = {}
    for _, setting in curves.groupby(list(SETTING), sort=False):
        end = float(setting[along].max())
        for run, moments in setting.groupby("run", sort=False):
            x, y = moments[along].to_numpy(float), moments[score].to_numpy(float)
            if end > 0.0 and np.isfinite(x).all():
                found[str(run)] = mean_height(x, y, end)
    return found


def with_areas(campaign: Campaign, score: str = HEADLINE) -> Any:
    """The runs with the areas under their curves of a score: ``area_path`` and so on (`AREAS`)."""
    runs = campaign.runs.copy()
    for name, along in AREAS.items():
        runs[name] = runs["run"].map(areas(campaign.curves, score, along))
    return runs


def summarise_campaign(campaign: Campaign, score: str = HEADLINE) -> list[Table]:
    """Means over the seeds.

    Returns:
        One row for each combination: its names, ``seeds``, and for the score, the areas, pings and
        path ``{"mean", "ci95"}``, as in a comparison.
    """
    rows = []
    for names, group in with_areas(campaign, score).groupby(list(FACTORS[:-1]), sort=False):
        row: Table = dict(zip(FACTORS, names, strict=False)) | {"seeds": len(group)}
        for key in (score, "area_path", "area_pings", "scans", "pings", "path_m"):
            mean, half = interval(group[key].to_numpy(float))
            row[key] = {"mean": mean, "ci95": half}
        rows.append(row)
    return rows


def paired(runs: Any, score: str = HEADLINE) -> list[Table]:
    """Differences, seed by seed, between runs that differ in one factor alone.

    Planner against planner with the same mapper, mapper against mapper with the same planner, and
    so on: what one gains is not credited to the other.

    Args:
        runs: As of `Campaign`, or of `with_areas`.
        score: A column of theirs.

    Returns:
        One row a pair: ``factor``, the two ``names``, all that is the ``same``, ``seeds``, the
        ``mean`` of first less second, half its ``ci95``, ``p`` of Student's paired t-test and
        ``p_holm``, corrected for all rows (both None for a single seed).
    """
    rows = [row for factor in FACTORS[:-1] for row in _pairs(runs, factor, score)]
    tested = [row for row in rows if row["p"] is not None]
    for row, corrected in zip(tested, holm([row["p"] for row in tested]), strict=True):
        row["p_holm"] = corrected
    return rows


def _pairs(runs: Any, factor: str, score: str) -> Iterator[Table]:
    """All pairs of one factor; scenarios are not to be compared."""
    if factor == "scenario" or score not in runs.columns:
        return
    others = [name for name in FACTORS[:-1] if name != factor]
    for same, group in runs.groupby(others, sort=False):
        by = {
            name: dict(zip(rows["seed"], rows[score].to_numpy(float), strict=True))
            for name, rows in group.groupby(factor, sort=False)
        }
        for one, other in combinations(by, 2):
            both = [seed for seed in by[one] if seed in by[other]]
            differences = np.array([by[one][seed] - by[other][seed] for seed in both])
            differences = differences[np.isfinite(differences)]
            if not len(differences):
                continue
            mean, half = interval(differences)
            yield {
                "factor": factor,
                "names": (one, other),
                "same": dict(zip(others, same, strict=True)),
                "seeds": len(differences),
                "mean": mean,
                "ci95": half,
                "p": paired_p(differences),
                "p_holm": None,
            }
