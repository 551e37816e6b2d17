"""Flying a vehicle with several sonars over a world."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    OutOption,
    SetOption,
    absolute_world,
    app,
    choices,
    file_layers,
    interruptible,
    single_layers,
)
from insonify.cli.vehicles import (
    CurrentOption,
    NavigationOption,
    RealTimeOption,
    VehicleOption,
    vehicle_table,
    wall_clock,
)
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.scenarios import Table
    from insonify.tours import MountedSonar, Sounding, Tour


@app.command()
def fly(
    world: Annotated[
        str | None, typer.Argument(help="SDF world or model, mesh file, scenario, or tank, grid...")
    ] = None,
    waypoints: Annotated[
        str | None,
        typer.Option(metavar="'X Y Z HEADING; ...'", help="Metres, degrees; the first: the start."),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Waypoints from CSV with x_m, y_m, z_m, yaw_deg."),
    ] = None,
    vehicle: VehicleOption = None,
    current: CurrentOption = None,
    navigation: NavigationOption = None,
    sonars: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="flatfish, or a TOML file with [[sonars]]."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of sensors and images.")] = None,
    real_time: RealTimeOption = False,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Fly a vehicle with several sonars over a world; each pings on its own clock."""
    from insonify.io.folders import result_folder, unused_folder
    from insonify.planning.decision import StopReason
    from insonify.simulation import build_scene
    from insonify.tours import Sounding, tour, tour_config
    from insonify.vehicle.craft import Craft

    chosen = choices(
        world=absolute_world(world),
        seed=seed,
        sonars=sonars,
        vehicle=vehicle_table(vehicle, current, navigation),
        waypoints=_waypoints(waypoints, path),
    )
    full = tour_config([*file_layers(config), chosen, *single_layers(settings)])
    scene = build_scene(full.world)
    folder = out or unused_folder(Path("insonify-runs") / f"fly-{Path(full.world).stem}")
    reason = StopReason.INTERRUPTED
    with result_folder(folder, force=force) as place, interruptible() as interrupted:
        soundings: list[Sounding] = []
        craft: Craft | None = None
        pace = wall_clock() if real_time else lambda time_s: None
        for record in tour(full, scene, pace):
            if isinstance(record, Sounding):
                soundings.append(record)
            elif isinstance(record, StopReason):
                reason = record
            else:
                craft = record
            if interrupted():
                break
        assert craft is not None
        result = _write(full, craft, soundings, reason, place.scratch)
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        for name, count in result["pings"].items():
            print(f"{name}: {count} pings")
        print(f"{result['path_m']:.1f} m in {result['time_s']:.1f} s. {result['stop_reason']}")
    print(f"Images and poses: {place.target}", file=sys.stderr)
    if interrupted():
        print("insonify: interrupted; what was heard until then is kept", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED)


def _waypoints(text: str | None, path: Path | None) -> list[list[float]] | None:
    if text is not None and path is not None:
        raise ConfigError("give --waypoints or --path, not both")
    if path is not None:
        from insonify.io.routes import read_route

        return [[*row[1:4], row[6]] for row in read_route(path).rows]
    if text is None:
        return None
    rows = []
    for part in text.split(";"):
        try:
            row = [float(word) for word in part.replace(",", " ").split()]
        except ValueError:
            row = []
        if len(row) not in (3, 4) or not all(map(math.isfinite, row)):
            raise ConfigError(
                f"--waypoints takes x, y, z and heading, rows parted by ';', not {part.strip()!r}"
            )
        rows.append(row if len(row) == 4 else [*row, 0.0])
    return rows


def _write(config: Tour, craft: Any, soundings: list[Sounding], reason: Any, folder: Path) -> Table:
    from insonify.io.configs import tour_to_toml
    from insonify.io.tours import save_soundings, save_turns
    from insonify.io.trajectories import save_track
    from insonify.sonar.devices import Kind
    from insonify.vehicle.craft import pose_errors

    (folder / "config.toml").write_text(tour_to_toml(config), encoding="utf-8")
    save_track(craft.track, folder / "trajectory.csv")
    save_soundings(soundings, folder)
    pings = {}
    for mounted in config.sonars:
        own = [one for one in soundings if one.sonar == mounted.name]
        pings[mounted.name] = len(own)
        if mounted.sonar.kind is Kind.SCANNING:
            save_turns(own, mounted, folder)
        _draw(own, mounted, folder)
    result = {
        "world": config.world,
        "vehicle": config.vehicle.name,
        "seed": config.seed,
        "stop_reason": reason.value,
        "time_s": craft.time_s,
        "path_m": round(craft.track.length_m, 6),
        "pose_error": pose_errors(craft.track),
        "pings": pings,
    }
    text = json.dumps(result, indent=2) + "\n"
    (folder / "result.json").write_text(text, encoding="utf-8")
    return result


def _draw(soundings: list[Sounding], mounted: MountedSonar, folder: Path) -> None:
    """Pictures of a sonar: three of its pings, or its turns, as they came and de-skewed."""
    from insonify.report.fans import draw_fan
    from insonify.sonar.devices import Kind
    from insonify.sonar.scanning import deskewed_image, polar_image
    from insonify.tours import turns_of

    if mounted.sonar.kind is not Kind.SCANNING:
        for share in (1, 2, 3) if len(soundings) > 3 else ():
            one = soundings[len(soundings) * share // 4]
            title = f"{mounted.name}, ping {one.number}, {one.ping.time_s:.2f} s"
            picture = draw_fan(one.ping, title, 8.0)
            (folder / f"{mounted.name}-{one.number:05d}.png").write_bytes(picture)
        return
    for number, turn in enumerate(turns_of(soundings, mounted)):
        kinds = {
            "polar": polar_image(turn, mounted.sonar),
            "deskewed": deskewed_image(turn, mounted.sonar, turn[0].pose),
        }
        for kind, image in kinds.items():
            title = f"{mounted.name}, turn {number}, {kind}, from {image.time_s:.2f} s"
            picture = draw_fan(image, title, 8.0)
            (folder / f"{mounted.name}-{number:05d}-{kind}.png").write_bytes(picture)
