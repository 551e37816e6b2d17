"""The report of a campaign: one HTML file that opens offline."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

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
        runs=len(runs),
        failed=[{"name": _named(row), **row} for row in campaign.failed],
        counts=[(name, runs[name].nunique()) for name in FACTORS] if flown else [],
        settings=list(_settings(campaign, runs)) if flown else [],
        tests=[
            {"score": label, "rows": [_told(row) for row in paired(runs, score)]}
            for score, label in _TESTED
        ]
        if flown
        else [],
        headline=HEADLINE.replace("_", " "),
    )
    path.write_text(page, encoding="utf-8")


_TESTED = (
    (HEADLINE, f"{HEADLINE.replace('_', ' ')} at the end"),
    ("area_path", f"mean of {HEADLINE.replace('_', ' ')} along the path"),
    ("area_pings", f"mean of {HEADLINE.replace('_', ' ')} over the pings"),
)


def _settings(campaign: Campaign, runs: Any) -> Iterator[Table]:
    """What is shown of each setting: the curves, and a table of final figures."""
    keys = list(SETTING)
    curves = dict(iter(campaign.curves.groupby(keys, sort=False)))
    rows = [*AREAS, "scans", "pings", "path_m", "time_s", *scores(campaign.runs)]
    for names, group in runs.groupby(keys, sort=False):
        by = dict(iter(group.groupby(["mapper", "planner"], sort=False)))
        yield {
            "name": ", ".join(map(str, names)),
            "curves": embed(draw_curves(curves[names], HEADLINE)),
            "columns": [" / ".join(map(short, one)) for one in by],
            "rows": [
                (row.replace("_", " "), [_cell(one[row].dropna()) for one in by.values()])
                for row in rows
                if group[row].notna().any()
            ],
        }


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
