"""What every subcommand shares: the app, its options, its messages, Ctrl-C."""

from __future__ import annotations

import math
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.helping import Commands
from insonify.cli.printing import tell
from insonify.errors import ConfigError, GeometryError

if TYPE_CHECKING:
    from insonify.config.settings import Table
    from insonify.io.datum import Datum
    from insonify.mission.setup import Config

EXIT_FAILED, EXIT_BAD_INPUT, EXIT_NOTHING, EXIT_INTERRUPTED, EXIT_BROKEN_PIPE = 1, 2, 3, 130, 141

app = typer.Typer(
    cls=Commands,
    help="Simulate imaging sonar, map with it, and decide where to scan next.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one setting; may be repeated."),
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="TOML file of settings; see: config")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]

OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace results in DIR.")]
PlannerOption = Annotated[
    str | None,
    typer.Option(
        "--planner",
        metavar="NAME",
        help="entropy, uniform, lawnmower, uniform-near, lawnmower-near, rosette, information; or "
        "your own: module:Name or file.py:Name.",
    ),
]
MapperOption = Annotated[
    str | None,
    typer.Option(
        "--mapper", metavar="NAME", help="bayes, carving; or your own: module:Name or file.py:Name."
    ),
]
RendererOption = Annotated[
    str | None, typer.Option("--renderer", help="embree or opengl.", show_default=False)
]
ModelOption = Annotated[str | None, typer.Option(help="cerqueira or physical.", show_default=False)]
RangeOption = Annotated[
    float | None,
    typer.Option("--range", metavar="M", help="Greatest range, instead of the device's own."),
]
MemoryOption = Annotated[
    str | None,
    typer.Option(
        "--memory",
        metavar="SIZE",
        help="Of the map, keep no more than this in memory, as in 500MB or 2GB, and the rest on "
        "disk.",
    ),
]
SearchOption = Annotated[
    list[Path] | None,
    typer.Option("--search", metavar="DIR", help="Look for models here; may be repeated."),
]
MaterialsOption = Annotated[
    Path | None,
    typer.Option("--materials", metavar="FILE", help="TOML table of materials by name."),
]


class Interrupted(BaseException):
    """Ctrl-C; not a KeyboardInterrupt, which typer would turn into exit code 1."""


def choices(**given: Any) -> Table:
    """The options that were given, as a layer of settings."""
    return {key: value for key, value in given.items() if value is not None}


def with_range(settings: list[str] | None, range_m: float | None) -> list[str] | None:
    """Single settings, below them the sonar's range if it was given."""
    if range_m is None:
        return settings
    return [f"sonar.range_max_m={range_m}", *(settings or [])]


def absolute(name: str | None) -> str | None:
    """A file that was named by its whole path, so that the saved config runs from any folder."""
    from insonify.config.layers import absolute as whole

    return None if name is None else whole(name)


def world_and_layers(
    world: str | None, config: Path | None, settings: list[str] | None, chosen: Table
) -> tuple[str, list[Table]]:
    """The world of a command, and the settings on top: file, then options, then single settings.

    Raises:
        ConfigError: Neither the command nor the file names a world.
    """
    from_file = file_layers(config)
    if world is None:
        if not from_file or "world" not in from_file[0]:
            raise ConfigError(
                "name a world (a file, or tank, grid, structures), or give a --config"
            )
        world = str(from_file[0]["world"])
    return absolute(world) or world, [*from_file, chosen, *single_layers(settings)]


def world_table(search: list[Path] | None, materials: Path | None) -> Table:
    """Where a world's models and materials are, as settings that hold from any folder."""
    folders = [str(folder.absolute()) for folder in search or ()] or None
    return choices(search=folders, materials=str(materials.absolute()) if materials else None)


def file_layers(config: Path | None) -> list[Table]:
    """The settings of a config file, if one is given."""
    from insonify.config.layers import read_layer

    return [read_layer(config)] if config else []


def single_layers(settings: list[str] | None) -> list[Table]:
    """The settings given one by one, each a layer."""
    from insonify.config.layers import parse_setting

    return [parse_setting(text) for text in settings or []]


def configure(
    scenario: str | None, config: Path | None, settings: list[str] | None, chosen: Table
) -> Config:
    """The config of a command: scenario, then file, then options, then single settings."""
    from insonify.mission.setup import scenario_config

    from_file, single = file_layers(config), single_layers(settings)
    if scenario is None:
        if not from_file or "scenario" not in from_file[0]:
            raise ConfigError("name a scenario (see `insonify scenarios`), or give a --config")
        scenario = str(from_file[0]["scenario"])
    return scenario_config(scenario, [*from_file, chosen, *single])


@contextmanager
def interruptible(
    ending: str = "finishing with what is complete; Ctrl-C again discards it",
    *signals: signal.Signals,
) -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C into a question that the run asks; the second stops at once.

    Args:
        ending: Said at the first.
        signals: Those that are meant; by default that of Ctrl-C.
    """
    asked = False

    def ask(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise Interrupted
        asked = True
        tell(f"insonify: {ending}")

    before = {number: signal.signal(number, ask) for number in signals or (signal.SIGINT,)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def datum_from_text(text: str) -> Datum:
    """The place of a --datum.

    Raises:
        GeometryError: It is not two or three numbers, or no place on the Earth.
    """
    from insonify.io.datum import Datum

    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise GeometryError(
            f"--datum takes latitude and longitude in degrees and a height in metres, as in "
            f"'41.5 -71.3 0', not {text!r}"
        )
    return Datum(*numbers)


def memory_limit(text: str | None) -> int | None:
    """The bytes of a --memory, if there is one.

    Raises:
        ConfigError: It is no size.
    """
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT]?)(i?)B?\s*", text)
    if found is None:
        raise ConfigError(f"--memory takes a size, as in 500MB or 2GB, not {text!r}")
    number, prefix, binary = found.groups()
    return int(float(number) * (1024 if binary else 1000) ** " kMGT".index(prefix or " "))


def print_report(folder: Path) -> None:
    """Say where a result's report is; where it lies, if there is none."""
    report = folder / "report.html"
    where = f"Report: {report}" if report.is_file() else f"Results: {folder}"
    tell(where)


def numbers_of(option: str, text: str, count: int) -> list[float]:
    """The numbers of an option's text.

    Raises:
        ConfigError: They are more or fewer, or not finite.
    """
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError as err:
        raise ConfigError(f"{option} takes {count} numbers, not {text!r}") from err
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ConfigError(f"{option} takes {count} finite numbers, not {text!r}")
    return values
