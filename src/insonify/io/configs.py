"""Configs as commented TOML."""

from __future__ import annotations

import tomlkit
from pydantic import BaseModel
from tomlkit.items import Table

from insonify.scenarios import Config


def config_to_toml(config: Config) -> str:
    """The whole config, each setting with its meaning; ``--config`` takes it back."""
    document = tomlkit.document()
    document.add(tomlkit.comment("A scan, with all that is needed to run it again:"))
    document.add(tomlkit.comment("insonify scan --config THIS_FILE"))
    _fill(document, config)
    return tomlkit.dumps(document)


def settings_to_toml(settings: BaseModel) -> str:
    """One table of settings, such as a sonar's description, each with its meaning."""
    document = tomlkit.document()
    _fill(document, settings)
    return tomlkit.dumps(document)


def _fill(into: tomlkit.TOMLDocument | Table, settings: BaseModel) -> None:
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            table = tomlkit.table()
            _fill(table, value)
            into.add(tomlkit.nl())
            into.add(name, table)
            continue
        item = tomlkit.item(str(value) if isinstance(value, str) else value)
        if field.description:
            item.comment(field.description)
        into.add(name, item)
