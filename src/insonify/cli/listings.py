"""What is known by name, and configs."""

from __future__ import annotations

import json

from insonify.cli.root import (
    ConfigOption,
    JsonOption,
    ScenarioArgument,
    SetOption,
    app,
    configure,
    print_listing,
)


@app.command()
def scenarios(as_json: JsonOption = False) -> None:
    """List the named scenarios."""
    from insonify.scenarios import scenarios as known

    rows = [{"name": name, "title": table["title"]} for name, table in known().items()]
    if as_json:
        print(json.dumps(rows, indent=2))
    else:
        print_listing(["name", "what it is"], [[row["name"], row["title"]] for row in rows])


@app.command()
def sonars(as_json: JsonOption = False) -> None:
    """List the sonars known by name."""
    from insonify.sonar.devices import sonar_presets

    rows = [{"name": name, **table} for name, table in sonar_presets().items()]
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    cells = [
        [
            row["name"],
            f"{row['azimuth_fov_deg']:g} x {row['elevation_fov_deg']:g}",
            f"{row['beams']} x {row['bins']}",
            f"{row['range_min_m']:g}-{row['range_max_m']:g}",
            row["source"],
        ]
        for row in rows
    ]
    print_listing(["name", "fan, deg", "beams x bins", "range, m", "source"], cells)


@app.command("config")
def show_config(
    scenario: ScenarioArgument,
    settings: SetOption = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the full config of a scenario; scan --config takes it back."""
    from insonify.io.configs import config_to_toml

    full = configure(scenario, config, settings, {})
    if as_json:
        print(json.dumps(full.model_dump(mode="json"), indent=2))
    else:
        print(config_to_toml(full), end="")
