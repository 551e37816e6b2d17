"""Settings in layers: named tables, files, single settings, each on top of the one before."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from insonify.config.settings import Table
from insonify.errors import ConfigError, reading
from insonify.limits import MOST_KEY_DOTS, MOST_TOML_BYTES

FILE_KEYS = (
    ("world",),
    ("materials",),
    ("planner",),
    ("mapper",),
    ("sonars",),
    ("objects", "mesh"),
    ("object", "mesh"),
    ("field", "kinds"),
    ("seabed", "raster"),
    ("sonar", "preset"),
    ("vehicle", "name"),
)
"""Settings that may name a file, which is then looked for beside the config that names it."""


@cache
def named_tables(name: str) -> dict[str, Table]:
    """What comes with insonify by name: the tables of ``config/NAME.toml``."""
    file = resources.files("insonify.config").joinpath(f"{name}.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def read_table(path: Path, what: str = "config file") -> Table:
    """A TOML file; ``what`` it should be is for messages.

    Raises:
        ConfigError: The file is missing or not TOML.
    """
    with reading(path, what, ConfigError), path.open("rb") as file:
        raw = file.read(MOST_TOML_BYTES + 1)
    if len(raw) > MOST_TOML_BYTES:
        raise ConfigError(f"{path}: more than {MOST_TOML_BYTES >> 20} MiB are no {what}")
    with reading(path, "TOML", ConfigError, ValueError, RecursionError):
        text = raw.decode("utf-8").replace("\r\n", "\n")
        if any(part.count(".") > MOST_KEY_DOTS for line in text.split("\n")
               for part in line.split(",")):  # fmt: skip
            raise ConfigError(f"{path}: a key has more than {MOST_KEY_DOTS} parts")
        return tomllib.loads(text)


def read_layer(path: Path) -> Table:
    """A config file as one layer of settings; a path in it is relative to the file.

    Raises:
        ConfigError: The file is missing or not TOML.
    """
    return settled(read_table(path), path.parent)


def settled(table: Table, folder: Path) -> Table:
    """Files that a table names by their whole path; they are looked for in a folder."""
    for holder, key in named_files(table):
        holder[key] = absolute(holder[key], folder)
    return table


def named_files(table: Table) -> list[tuple[Any, Any]]:
    """The settings of a table that may name a file (`FILE_KEYS`): what holds each, and its key."""
    return [place for keys in FILE_KEYS for place in _strings(table, keys)]


def _strings(holder: Any, keys: tuple[str, ...]) -> list[tuple[Any, Any]]:
    """Strings under nested keys; where there is a list, of each thing in it."""
    if isinstance(holder, list):
        return [place for one in holder for place in _strings(one, keys)]
    if not isinstance(holder, dict) or keys[0] not in holder:
        return []
    inner = holder[keys[0]]
    if len(keys) > 1:
        return _strings(inner, keys[1:])
    if isinstance(inner, list):
        return [(inner, k) for k, one in enumerate(inner) if isinstance(one, str)]
    return [(holder, keys[0])] if isinstance(inner, str) else []


def absolute(name: str, folder: Path | None = None) -> str:
    """A name of a file that is there by its whole path, so that it holds from any folder.

    Names without a suffix are left alone, as they may be known ones; ``FILE.py:NAME`` is a file.
    """
    file, colon, inside = name.partition(":") if ".py:" in name else (name, "", "")
    path = (folder or Path.cwd()) / os.path.expanduser(file)  # noqa: PTH111
    return f"{path.absolute()}{colon}{inside}" if path.suffix and path.is_file() else name


def parse_setting(text: str) -> Table:
    """One ``KEY=VALUE`` as a layer; the key is dotted, the value TOML, or else a string.

    A file that it names is relative to the current folder.

    Raises:
        ConfigError: There is no ``=`` in it.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set takes KEY=VALUE, as in mapping.voxel_m=0.2, not {text!r}")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        parsed = value
    for part in reversed(key.strip().split(".")):
        parsed = {part: parsed}
    return settled(dict(parsed), Path.cwd())


def overlaid(layers: Iterable[Table]) -> Table:
    """Nested tables merged, later ones winning.

    A device or the like may be told by the name of a preset, alone or as ``preset`` in its table;
    then it begins anew, and what lay below is forgotten.
    """
    merged: Table = {}
    for layer in layers:
        merged = _overlay(merged, layer)
    return merged


def _overlay(below: Table, above: Table) -> Table:
    merged = dict(below)
    for key, value in above.items():
        inner = merged.get(key)
        if key == "sonar" and isinstance(value, str):
            value = {"preset": value}
        if isinstance(value, dict) and isinstance(inner, dict) and "preset" not in value:
            value = _overlay(inner, value)
        merged[key] = value
    return merged
