"""What commands that fly a vehicle share."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say, say_table
from insonify.cli.root import choices
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.config.settings import Table
    from insonify.mission.setup import Config

VehicleOption = Annotated[
    str | None,
    typer.Option(metavar="NAME|FILE", help="Fly the scans by this vehicle; see: vehicles"),
]
CurrentOption = Annotated[
    str | None,
    typer.Option(metavar="'EAST NORTH UP'", help="Of the water, m/s; needs a vehicle."),
]
NavigationOption = Annotated[
    str | None,
    typer.Option(
        "--navigation", help="The vehicle's: truth, or dvl (estimated).", show_default=False
    ),
]
RealTimeOption = Annotated[
    bool, typer.Option("--real-time", help="Fly no faster than the clock on the wall.")
]


def vehicle_table(
    vehicle: str | None, current: str | None = None, navigation: str | None = None
) -> Table | None:
    """The options of a vehicle as settings; a file's path is made absolute."""
    name = vehicle
    if vehicle is not None and vehicle.endswith(".toml"):
        name = str(Path(vehicle).absolute())
    table = choices(name=name, navigation=navigation)
    if current is not None:
        table["current"] = {"velocity_m_s": _velocity(current)}
    return table or None


def check_vehicle(
    config: Config, *, current: str | None, navigation: str | None, real_time: bool
) -> None:
    """Refuse a vehicle's options without a vehicle, and a vehicle that does not exist."""
    from insonify.vehicle.description import vehicle_named
    from insonify.vehicle.settings import TELEPORT

    if config.vehicle.name != TELEPORT:
        vehicle_named(config.vehicle.name)
        return
    given = {"--current": current, "--navigation": navigation, "--real-time": real_time or None}
    for option, value in given.items():
        if value is not None:
            raise ConfigError(f"{option} needs a vehicle to fly; add --vehicle bluerov2, for one")


def wall_clock() -> Callable[[float], None]:
    """A pace for hardware in the loop: each tick waits until its time has come."""
    begun: list[float] = []

    def wait(time_s: float) -> None:
        now = time.monotonic()
        if not begun:
            begun.append(now - time_s)
        time.sleep(max(0.0, begun[0] + time_s - now))

    return wait


def print_navigation(table: dict[str, Any]) -> None:
    """A comparison of navigations for people."""
    from rich import box
    from rich.table import Table as RichTable

    for name, by in table.items():
        view = RichTable(
            "", "perfect navigation", "own navigation", "difference",
            title=name, box=box.SIMPLE, padding=(0, 1, 0, 0),
        )  # fmt: skip
        for key in by["cost"]:
            view.add_row(key, *(_spread(by[column][key]) for column in ("truth", "dvl", "cost")))
        say_table(view)
    say("Mean over the seeds ± half of its 95 % confidence interval.")


def _spread(figure: dict[str, float | None]) -> str:
    half = "" if figure["ci95"] is None else f" ±{figure['ci95']:.3f}"
    return f"{figure['mean']:.3f}{half}"


def _velocity(text: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise ConfigError(
            f"--current takes three numbers, east, north and up in m/s, as in '0.2 0 0', "
            f"not {text!r}"
        )
    return numbers
