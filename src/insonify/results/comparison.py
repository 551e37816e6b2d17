"""What ``compare`` leaves: every run's figures, and one flat table of them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from insonify.config.settings import Table
from insonify.mission.result import ComparisonResult, ScanResult
from insonify.names import csv_cell
from insonify.results.files import save_result


def save_comparison(rows: Sequence[ScanResult], table: Table, folder: Path) -> None:
    """Write runs and their summary into a folder that exists: ``result.json`` and ``rows.csv``."""
    save_result(ComparisonResult(runs=tuple(rows), table=table), folder)
    flat = [row.to_row() for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    with (folder / "rows.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n", restval="")
        writer.writeheader()
        writer.writerows({name: csv_cell(value) for name, value in row.items()} for row in flat)
