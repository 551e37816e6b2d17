"""The small file beside a map that tells its origin, replaced with the map though they are two.

While a map is replaced, the file beside it tells which origin is whose by their digests, so that a
process that is killed in between leaves no map with the origin of another.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

BESIDE = ".origin.json"
"""Ends the name of the file that tells a map's origin where its format cannot."""
_OF, _FORMER = "of", "former"
_NONE: dict[str, Any] = {"origin_m": [0.0, 0.0, 0.0]}


def replace_beside(told: Path, beside: Path, new: Path, target: Path) -> None:
    """Before a map is replaced: let the file beside it tell the origins of both.

    Args:
        told: What is to be beside the new map; perhaps not there.
        beside: What is, or will be, beside the map.
        new: The new map.
        target: What it replaces; perhaps not there.
    """
    if not (told.is_file() or beside.is_file()) or new.is_dir():
        return
    both = (_read(told) or _NONE) | {_OF: _digest(new)}
    if target.is_file():
        both[_FORMER] = (_read(beside) or _NONE) | {_OF: _digest(target)}
    scratch = told.with_name(f"{told.name}.both")
    scratch.write_text(json.dumps(both), encoding="utf-8")
    scratch.replace(beside)


def finish_beside(beside: Path, target: Path) -> bool:
    """After a map was replaced, or a kill in between: let the file tell of the map alone.

    Returns:
        Whether there is a file beside that tells an origin.
    """
    table = _read(beside)
    if table is None or _OF not in table:
        return os.path.lexists(beside)
    mine = owners_table(table, target)
    if not target.is_file() or mine.get("origin_m") == _NONE["origin_m"]:
        beside.unlink()
        return False
    scratch = beside.with_name(f".{beside.name}.part")
    scratch.write_text(json.dumps(mine) + "\n", encoding="utf-8")
    scratch.replace(beside)
    return True


def owners_table(table: dict[str, Any], target: Path) -> dict[str, Any]:
    """Of a table of two maps, what it says of the one that is there; a plain table as it is."""
    former = table.get(_FORMER)
    if isinstance(former, dict) and _digest(target) == former.get(_OF):
        table = former
    return {key: value for key, value in table.items() if key not in (_OF, _FORMER)}


def _read(path: Path) -> dict[str, Any] | None:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return table if isinstance(table, dict) else None


def _digest(path: Path) -> str:
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
