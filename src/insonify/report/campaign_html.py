"""The report of a campaign: one HTML file that opens offline."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from insonify import __version__
from insonify.config.settings import Table
from insonify.mission.campaign import FACTORS
from insonify.mission.statistics import interval
from insonify.mission.tables import (
    AREAS,
    HEADLINE,
    SETTING,
    Campaign,
    paired,
    scores,
    short,
    with_areas,
)
from insonify.report.campaign_pictures import draw_curves
from insonify.report.html import embed, template


def write_campaign_report(campaign: Campaign, path: Path) -> None:
    """Write the report of a campaign, whole or not.

    Raises:
        MissingExtraError: The packages for reports are not installed.
    """
    flown = len(campaign.runs) > 0
    runs = with_areas(campaign) if flown else campaign.runs
    page = template("campaign.html.jinja").render(
        title=campaign.title or "Campaign",
        version=__version__,
        runs=len(runs),
        failed=[{"name": _named(row), **row} for row in campaign.failed],
        counts=list(_counts(runs)) if flown else [],
        settings=list(_settings(campaign, runs)) if flown else [],
        tests=[
            {"score": label, "rows": [_told(row) for row in paired(runs, score)]}
            for score, label in _TESTED
        ]
        if flown
        else [],
        headline=_words(HEADLINE),
    )
    path.write_text(page, encoding="utf-8")


_TESTED = (
    (HEADLINE, "F1 (solid, exact) at the end"),
    ("area_path", "F1 (solid, exact), mean along the path"),
    ("area_pings", "F1 (solid, exact), mean over the pings"),
)


def _settings(campaign: Campaign, runs: Any) -> Iterator[Table]:
    """What is shown of each setting: the curves, and a table of final figures."""
    keys = list(SETTING)
    curves = dict(iter(campaign.curves.groupby(keys, sort=False)))
    rows = [HEADLINE, *AREAS, "scans", "pings", "path_m", "time_s"]
    rows += [name for name in scores(campaign.runs) if name != HEADLINE]
    for names, group in runs.groupby(keys, sort=False):
        by = dict(iter(group.groupby(["mapper", "planner"], sort=False)))
        yield {
            "name": ", ".join(map(str, names)),
            "curves": [
                (name, embed(drawn))
                for name, drawn in draw_curves(curves[names], HEADLINE, _words(HEADLINE))
            ],
            "best": _best(by),
            "columns": [" / ".join(map(short, one)) for one in by],
            "rows": [
                (_words(row), [_cell(one[row].dropna()) for one in by.values()])
                for row in rows
                if group[row].notna().any()
            ],
        }


_WORDS = {
    "area_path": "F1 (solid, exact), mean along the path",
    "area_pings": "F1 (solid, exact), mean over the pings",
    "area_time": "F1 (solid, exact), mean over time",
    "path_m": "path, m",
    "time_s": "time, s",
}


def _words(column: str) -> str:
    """A column of the tables as people say it: ``solid_exact_f1`` is F1 (solid, exact)."""
    if column in _WORDS or "_" not in column:
        return _WORDS.get(column, column)
    kind, _, rest = column.partition("_")
    match, _, score = rest.rpartition("_")
    score = score.upper() if score in ("f1", "f2", "f3") else score
    return f"{score} ({kind}, {match.replace('_', ' ')})"


def _counts(runs: Any) -> Iterator[tuple[str, int]]:
    """What differs between the runs, and how many there are of each."""
    for name in FACTORS:
        count = runs[name].nunique()
        if count > 1:
            yield (name if name == "navigation" else f"{name}s"), count


def _best(by: Table) -> Table:
    """The mapper and planner with the highest mean at the end."""
    names = max(by, key=lambda one: by[one][HEADLINE].mean())
    values = by[names][HEADLINE].dropna()
    return {"name": " / ".join(map(short, names)), "score": _cell(values), "seeds": len(values)}


def _cell(values: Any) -> str:
    if not len(values):
        return ""
    mean, half = interval(values.to_numpy(float))
    digits = 3 if abs(mean) < 10 else 1
    spread = "" if half is None else f" ± {half:.{digits}f}"
    return f"{mean:.{digits}f}{spread}"


def _told(row: Table) -> Table:
    """A paired test as text."""
    p = {key: "" if row[key] is None else f"{row[key]:.2g}" for key in ("p", "p_holm")}
    half = "" if row["ci95"] is None else f" ± {row['ci95']:.3f}"
    return {
        "names": " - ".join(map(short, row["names"])),
        "same": ", ".join(short(str(value)) for value in row["same"].values()),
        "difference": f"{row['mean']:+.3f}{half}",
        "seeds": row["seeds"],
        "sure": row["p_holm"] is not None and row["p_holm"] < 0.05,
        **p,
    }


def _named(row: Table) -> str:
    return ", ".join(short(str(row.get(name, ""))) for name in FACTORS)
