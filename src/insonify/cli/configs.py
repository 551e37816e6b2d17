"""The settings of every command that has some, with their meanings, and their JSON Schema."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import say_json, say_lines
from insonify.cli.root import (
    ConfigOption,
    JsonOption,
    SetOption,
    app,
    configure,
    file_layers,
    single_layers,
    world_and_layers,
)
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import BaseModel


class Command(StrEnum):
    """Commands that are told what to do by a config."""

    SCAN = "scan"
    SIMULATE = "simulate"
    DATASET = "dataset"
    FLY = "fly"
    MAP = "map"


_HERE = [0.0, 0.0, 0.0, -5.0, 0.0, 0.0, 0.0]
_THERE = [[0.0, 0.0, -5.0, 0.0], [10.0, 0.0, -5.0, 0.0]]


@app.command("config")
def show_config(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="A scenario, a named simulation, or a world."),
    ] = None,
    command: Annotated[
        Command | None,
        typer.Option(
            "--for",
            help="The command that is to take it; by default scan for a scenario, else simulate.",
            show_default=False,
        ),
    ] = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the settings' JSON Schema instead.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print the full config of a scan, simulation, dataset, tour or map, for its --config."""
    from insonify.config.toml import config_to_toml

    chosen = command or _guessed(name, config)
    if schema:
        say_json(_model(chosen).model_json_schema())
        return
    full = _MAKERS[chosen](name, config, settings)
    if as_json:
        say_json(full.model_dump(mode="json"))
    else:
        say_lines(config_to_toml(full, chosen.value).removesuffix("\n"))


def _guessed(name: str | None, config: Path | None) -> Command:
    from insonify.config.layers import named_tables
    from insonify.scene.experiments import EXPERIMENTS

    given = file_layers(config)[0] if config is not None else {}
    world = name or str(given.get("world", ""))
    known = world in named_tables("simulations") or world in EXPERIMENTS or Path(world).suffix
    return Command.SIMULATE if known else Command.SCAN


def _model(command: Command) -> type[BaseModel]:
    from insonify.imaging.dataset import Dataset
    from insonify.imaging.route import Simulation
    from insonify.imaging.tour import Tour
    from insonify.mission.setup import Config
    from insonify.results.map import MapConfig

    models: dict[Command, type[BaseModel]] = {
        Command.SCAN: Config,
        Command.SIMULATE: Simulation,
        Command.DATASET: Dataset,
        Command.FLY: Tour,
        Command.MAP: MapConfig,
    }
    return models[command]


def _scan(name: str | None, config: Path | None, settings: list[str] | None) -> BaseModel:
    return configure(name, config, settings, {})


def _simulation(name: str | None, config: Path | None, settings: list[str] | None) -> BaseModel:
    """With a place to ping from, where none is said."""
    from insonify.config.layers import named_tables
    from insonify.imaging.route import simulation_config

    world, layers = world_and_layers(name, config, settings, {})
    if "route" not in named_tables("simulations").get(world, {}):
        layers = [{"route": [_HERE]}, *layers]
    return simulation_config(world, layers)


def _dataset(name: str | None, config: Path | None, settings: list[str] | None) -> BaseModel:
    from insonify.imaging.dataset import dataset_config

    return dataset_config(*world_and_layers(name, config, settings, {}))


def _tour(name: str | None, config: Path | None, settings: list[str] | None) -> BaseModel:
    """With waypoints, where none are said."""
    from insonify.imaging.tour import tour_config

    world = {} if name is None else {"world": name}
    single = single_layers(settings)
    return tour_config([{"waypoints": _THERE}, world, *file_layers(config), *single])


def _mapping(name: str | None, config: Path | None, settings: list[str] | None) -> BaseModel:
    from insonify.cli.recordings import map_config

    if name is not None:
        raise ConfigError(f"recordings are mapped as they are; leave {name!r} out")
    return map_config(None, None, settings, config)


_MAKERS: dict[Command, Callable[[str | None, Path | None, list[str] | None], BaseModel]] = {
    Command.SCAN: _scan,
    Command.SIMULATE: _simulation,
    Command.DATASET: _dataset,
    Command.FLY: _tour,
    Command.MAP: _mapping,
}
