"""The figures of every kind of job: frozen, versioned, the same in files, on screens, in tables."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from insonify import __version__
from insonify.config.settings import Settings, Table
from insonify.types import StopReason

Metrics = dict[str, dict[str, dict[str, float]]]
"""By kind of truth (surface, solid), tolerance (exact, within_one_voxel) and score."""


class Result(Settings):
    """What every result has.

    ``schema_version`` counts changes that a reader must know of; ``insonify`` is the version that
    wrote it.
    """

    kind: str
    schema_version: Literal[1] = 1
    insonify: str = __version__

    def to_json(self) -> Table:
        """As JSON's types; enumerations by name."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_row(self) -> dict[str, str | float | bool]:
        """One flat row for a table: nested keys joined by ``_``; lists are left out."""
        return dict(flat("", self.to_json()))


def flat(prefix: str, table: Table) -> list[tuple[str, Any]]:
    """Nested keys joined by ``_``, after a prefix, with their values; lists are left out."""
    rows: list[tuple[str, Any]] = []
    for key, value in table.items():
        if isinstance(value, dict):
            rows += flat(f"{prefix}{key}_", value)
        elif not isinstance(value, list):
            rows.append((prefix + key, value))
    return rows


class ScanRow(Settings):
    """The state of a scan's run after one of its scans; the time is a vehicle's."""

    scan: int
    pings: int
    path_m: float
    time_s: float | None = None
    total_entropy_bits: float
    metrics: Metrics
    ghosts: float | None = Field(
        None, description="occupied voxels in open water, of the object's; older files do not tell"
    )


class FlightResult(Settings):
    """What a vehicle's navigation cost."""

    name: str
    navigation: str
    time_s: float
    pose_error: dict[str, float]
    metrics_at_true_poses: Metrics


class ScanResult(Result):
    """A run of ``scan``."""

    kind: Literal["scan"] = "scan"
    scenario: str
    planner: str
    mapper: str
    seed: int
    scans: int
    pings: int
    path_m: float
    stop_reason: StopReason
    why_stopped: str | None = Field(
        None, description="in a sentence, with the numbers compared; older files do not tell"
    )
    metrics: Metrics
    history: tuple[ScanRow, ...]
    region_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = Field(
        None, description="the designated area; older files do not tell"
    )
    seconds: dict[str, float]
    vehicle: FlightResult | None = None


class MapResult(Result):
    """A map made of recordings."""

    kind: Literal["map"] = "map"
    mapper: str = "bayes"
    recordings: tuple[Table, ...]
    pings: int
    path_m: float
    brightest_pixel: float | None = Field(None, description="of 1; older files do not tell")
    fans: tuple[Table, ...]
    mapping: Table
    origin_m: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="of the map's own frame, in the world"
    )
    occupied_voxels: int
    region_m: tuple[tuple[float, float, float], tuple[float, float, float]]
    region: dict[str, float]
    seconds: dict[str, float]


class ImagesResult(Result):
    """What ``simulate`` made."""

    kind: Literal["images"] = "images"
    world: str
    sonar: str
    sonar_kind: str
    model: str
    renderer: str
    seed: int
    labels: tuple[str, ...]
    pings: tuple[Table, ...]


class TourResult(Result):
    """What ``fly`` heard."""

    kind: Literal["tour"] = "tour"
    world: str
    vehicle: str
    seed: int
    stop_reason: StopReason
    time_s: float
    path_m: float
    pose_error: dict[str, float]
    pings: dict[str, int]


class DatasetResult(Result):
    """What ``dataset`` made."""

    kind: Literal["dataset"] = "dataset"
    world: str
    sonar: str
    seed: int
    views: int
    categories: dict[str, dict[str, int]]
    parts: dict[str, Table] = Field(
        {}, description="views and worlds of train, val and test; older files do not tell"
    )


class ComparisonResult(Result):
    """Runs side by side, and the means over their seeds."""

    kind: Literal["comparison"] = "comparison"
    runs: tuple[ScanResult, ...]
    table: Table


class CampaignResult(Result):
    """What ``campaign`` flew, so far: how many of its runs, and the means over their seeds."""

    kind: Literal["campaign"] = "campaign"
    title: str
    runs: int
    planned: int
    failed: int
    table: tuple[Table, ...]


RESULTS: dict[str, type[Result]] = {
    "scan": ScanResult,
    "map": MapResult,
    "images": ImagesResult,
    "tour": TourResult,
    "dataset": DatasetResult,
    "comparison": ComparisonResult,
    "campaign": CampaignResult,
}
