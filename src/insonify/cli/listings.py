"""What is known by name."""

from __future__ import annotations

import json
import textwrap

from insonify.cli.root import JsonOption, app, print_listing


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
        print(json.dumps(rows, indent=2))
    else:
        cells = [[row["name"], row["command"], row["title"]] for row in rows]
        print_listing(["name", "for", "what it is"], cells)


@app.command()
def sonars(as_json: JsonOption = False) -> None:
    """List the sonars known by name."""
    from insonify.sonar.devices import sonar_presets

    rows = [{"name": name, **table} for name, table in sonar_presets().items()]
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        print(
            f"{row['name']}: {row.get('kind', 'forward-looking')}, "
            f"{row['azimuth_fov_deg']:g} x {row['elevation_fov_deg']:g} degrees, "
            f"{row['beams']} beams x {row['bins']} bins, "
            f"{row['range_min_m']:g}-{row['range_max_m']:g} m"
        )
        unconfirmed = ", ".join(row["unconfirmed"]) or "nothing"
        about = f"{row['source']}. Not confirmed: {unconfirmed}."
        print(textwrap.fill(about, 88, initial_indent="    ", subsequent_indent="    "))


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
        print(json.dumps(rows, indent=2))
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
    print_listing(["name", "mass, kg", "size, m", "thrusters", "source"], cells)
