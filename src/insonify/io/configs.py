"""Configs as commented TOML."""

from __future__ import annotations

import tomlkit
from pydantic import BaseModel
from tomlkit.items import AoT, Table

from insonify.datasets import Dataset
from insonify.scenarios import Config
from insonify.simulation import Simulation
from insonify.tours import Tour


def config_to_toml(config: Config) -> str:
    """The whole config, each setting with its meaning; ``--config`` takes it back."""
    return _commented(config, "A scan", "insonify scan --config THIS_FILE")


def simulation_to_toml(config: Simulation) -> str:
    """The settings of a simulation, each with its meaning; ``--config`` takes them back."""
    return _commented(config, "A simulation", "insonify simulate --config THIS_FILE")


def tour_to_toml(config: Tour) -> str:
    """The settings of a tour, each with its meaning; ``--config`` takes them back."""
    return _commented(config, "A tour", "insonify fly --config THIS_FILE")


def dataset_to_toml(config: Dataset) -> str:
    """The settings of a dataset, each with its meaning; ``--config`` takes them back."""
    return _commented(config, "A dataset", "insonify dataset --config THIS_FILE")


def _commented(settings: BaseModel, what: str, command: str) -> str:
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{what}, with all that is needed to run it again:"))
    document.add(tomlkit.comment(command))
    _fill(document, settings)
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
        if isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            into.add(name, _tables(value))
            continue
        item = tomlkit.item(_plain(value))
        if field.description:
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
    """As TOML's own types: enumerations are strings, tuples lists."""
    if isinstance(value, str):
        return str(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value
