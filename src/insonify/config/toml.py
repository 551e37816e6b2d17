"""Settings as commented TOML."""

from __future__ import annotations

from pathlib import PurePath

import tomlkit
from pydantic import BaseModel
from tomlkit.items import AoT, Table


def to_toml(settings: BaseModel, head: str = "") -> str:
    """The settings, each with its meaning.

    Args:
        settings: Any model.
        head: Lines of a comment before them.
    """
    document = tomlkit.document()
    for line in head.splitlines():
        document.add(tomlkit.comment(line))
    _fill(document, settings)
    return tomlkit.dumps(document)


def config_to_toml(settings: BaseModel, command: str) -> str:
    """A whole config, which ``insonify COMMAND --config`` takes back."""
    return to_toml(
        settings,
        f"All that `insonify {command}` needs to make the same again:\n"
        f"insonify {command} --config THIS_FILE",
    )


def _fill(into: tomlkit.TOMLDocument | Table, settings: BaseModel) -> None:
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            table = tomlkit.table()
            _fill(table, value)
            into.add(tomlkit.nl())
            into.add(name, table)
            continue
        if isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            into.add(name, _tables(value))
            continue
        if isinstance(value, dict) and not value:
            continue
        item = tomlkit.item(_plain(value))
        if field.description and not isinstance(value, dict):
            item.comment(field.description)
        into.add(name, item)


def _tables(rows: tuple[BaseModel, ...]) -> AoT:
    """Settings of several things, each a table of an array."""
    tables = tomlkit.aot()
    for row in rows:
        table = tomlkit.table()
        _fill(table, row)
        tables.append(table)
    return tables


def _plain(value: object) -> object:
    """As TOML's own types: enumerations and paths are strings, tuples lists."""
    if isinstance(value, str | PurePath):
        return str(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value
