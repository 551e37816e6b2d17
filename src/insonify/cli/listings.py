"""What is known by name."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Annotated

import typer

from insonify.cli.printing import say, say_json, say_lines, say_listing
from insonify.cli.root import JsonOption, app


@app.command()
def scenarios(as_json: JsonOption = False) -> None:
    """List the named scenarios of scan, and those of simulate."""
    from insonify.config.layers import named_tables

    rows = [
        {"name": name, "command": command, "title": table["title"]}
        for command, tables in (
            ("scan", named_tables("scenarios")),
            ("simulate", named_tables("simulations")),
        )
        for name, table in tables.items()
    ]
    if as_json:
        say_json(rows)
    else:
        cells = [[row["name"], row["command"], row["title"]] for row in rows]
        say_listing(["name", "for", "what it is"], cells)


@app.command()
def sonars(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="An SDF world or model, or a Stonefish .scn."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the sonars known by name, or those that a world describes, as --sonar FILE.toml."""
    from insonify.sonar.devices import sonar_presets

    if file is not None:
        _list_described(file, as_json)
        return
    rows = [{"name": name, **table} for name, table in sonar_presets().items()]
    if as_json:
        say_json(rows)
        return
    for row in rows:
        say(
            f"{row['name']}: {row.get('kind', 'forward-looking')}, "
            f"{row['azimuth_fov_deg']:g} x {row['elevation_fov_deg']:g} degrees, "
            f"{row['beams']} beams x {row['bins']} bins, "
            f"{row['range_min_m']:g}-{row['range_max_m']:g} m"
        )
        unconfirmed = ", ".join(row["unconfirmed"]) or "nothing"
        about = f"{row['source']}. Not confirmed: {unconfirmed}."
        say_lines(textwrap.fill(about, 88, initial_indent="    ", subsequent_indent="    "))


def _list_described(file: Path, as_json: bool) -> None:
    """The sonars of a world, each as the TOML of a device."""
    from insonify.config.settings import validated
    from insonify.config.toml import to_toml
    from insonify.sonar.described import described_sonars
    from insonify.sonar.devices import SonarDevice

    devices = [validated(SonarDevice, table, where=str(file)) for table in described_sonars(file)]
    if as_json:
        say_json([device.model_dump(mode="json") for device in devices])
        return
    for device in devices:
        say_lines(to_toml(device, f"--sonar '{file}#{device.name}', or this as a file"))


@app.command()
def vehicles(as_json: JsonOption = False) -> None:
    """List the vehicles known by name."""
    from insonify.vehicle.description import vehicle_named
    from insonify.vehicle.description import vehicles as known

    rows = [
        vehicle_named(name).model_dump(mode="json") | {"source": table["source"]}
        for name, table in known().items()
    ]
    if as_json:
        say_json(rows)
        return
    cells = [
        [
            row["name"],
            f"{row['mass_kg']:g}",
            " x ".join(f"{edge:g}" for edge in row["size_m"]),
            str(len(row["thrusters"])),
            row["source"],
        ]
        for row in rows
    ]
    say_listing(["name", "mass, kg", "size, m", "thrusters", "source"], cells)
