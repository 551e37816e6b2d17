"""The one file that every result has: its figures, written and read back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from insonify.config.settings import validated
from insonify.errors import ConfigError, ResultError
from insonify.io.folders import RESULT
from insonify.mission.result import RESULTS, Result
from insonify.types import StopReason

CONFIG, RECORDING = "config.toml", "recording.mcap"
_TELLING = {
    "recordings": "map",
    "stop_reason": "scan",
    "renderer": "images",
}
"""Keys by which a file of version 0.1, which did not say so, is told."""


def save_result(result: Result, folder: Path) -> None:
    """Write a result's figures into its folder."""
    text = json.dumps(result.to_json(), indent=2) + "\n"
    (folder / RESULT).write_text(text, encoding="utf-8")


def load_result(path: Path | str) -> Result:
    """Read a result's figures back, of this version or an older one.

    Args:
        path: A result's folder, or its ``result.json``.

    Raises:
        ResultError: The file is missing, damaged, or of a version that is not known.
    """
    path = Path(path)
    file = path / RESULT if path.is_dir() else path
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError as err:
        raise ResultError(f"{file}: there is no such result; check the path") from err
    except (OSError, ValueError, RecursionError) as err:
        raise ResultError(f"{file}: cannot be read as a result ({err})") from err
    if not isinstance(table, dict):
        raise ResultError(f"{file}: holds no result")
    if "schema_version" not in table:
        table = _of_today(file, table)
    model = RESULTS.get(str(table.get("kind")))
    if model is None or table["schema_version"] != 1:
        what = f"{table.get('kind')!r} of version {table['schema_version']!r}"
        raise ResultError(f"{file}: a result {what}, which this version of insonify cannot read")
    try:
        return validated(model, table, where=str(file), see="docs/reference/results.md")
    except ConfigError as err:
        raise ResultError(str(err)) from err


def _of_today(file: Path, table: dict[str, Any]) -> dict[str, Any]:
    """A table of version 0.1 as one of today."""
    if "stop_reason" in table and isinstance(table.get("pings"), dict):
        kind: str | None = "tour"
    else:
        kind = next((kind for key, kind in _TELLING.items() if key in table), None)
    if kind is None:
        raise ResultError(f"{file}: no result of insonify, it does not say what kind it is")
    table = {"sonar_kind": table["kind"]} | table if kind == "images" else table
    table = table | {"kind": kind, "schema_version": 1, "insonify": "0.1.0"}
    if "stop_reason" in table:
        sentences = {reason.sentence: reason.value for reason in StopReason}
        table["stop_reason"] = sentences.get(table["stop_reason"], table["stop_reason"])
    return table
