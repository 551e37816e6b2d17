"""The next scan for a real vehicle, from a saved map."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say_json, say_listing, tell
from insonify.cli.progress import begin
from insonify.cli.root import (
    EXIT_NOTHING,
    JsonOption,
    MemoryOption,
    SetOption,
    app,
    datum_from_text,
    memory_limit,
    single_layers,
)
from insonify.cli.words import plan_rows
from insonify.errors import ConfigError, GeometryError

if TYPE_CHECKING:
    from insonify.io.datum import Datum
    from insonify.mapping.voxels import VoxelMap
    from insonify.mission.setup import Config
    from insonify.planning.active import EntropySettings
    from insonify.planning.decision import Decision
    from insonify.sonar.devices import SonarDevice
    from insonify.types import Box, Pose, ScanPath


RegionOption = Annotated[
    str | None,
    typer.Option(
        metavar="'X0 Y0 Z0 X1 Y1 Z1'", help="Where uncertainty counts; default: the map's."
    ),
]
DatumOption = Annotated[
    str | None,
    typer.Option(
        metavar="'LAT LON [HEIGHT]'", help="Of the map's origin (WGS 84), for GeoJSON and QGC."
    ),
]


@app.command()
def plan(
    map_: Annotated[
        Path, typer.Argument(metavar="MAP", help="Result folder, or .npz, .zarr, .ot, .bt.")
    ],
    from_: Annotated[
        str,
        typer.Option(
            "--from", metavar="'X Y Z YAW'", help="The vehicle's pose: metres in the map, degrees."
        ),
    ],
    sonar: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE.toml", help="By default the one beside the map."),
    ] = None,
    region: RegionOption = None,
    memory: MemoryOption = None,
    datum: DatumOption = None,
    clearance: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            metavar="M",
            help="Least, to what is mapped. Default: the scan's, or 0.4.",
        ),
    ] = None,
    waypoints: Annotated[int, typer.Option(min=1, max=10000, help="Pings of the scan.")] = 40,
    speed: Annotated[
        float, typer.Option(min=0.01, max=10.0, metavar="M/S", help="How fast it is to be flown.")
    ] = 0.5,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw it from above and from the side.")
    ] = None,
    upload: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Give it to an autopilot by MAVLink, as udp:127.0.0.1:14550."
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR|FILE.plan", help="For the path; or QGC's plan alone."),
    ] = Path("plan"),
    settings: SetOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace results in DIR.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Plan the next scan path from a map: where it would resolve most of what is undecided."""
    from insonify.cli.recordings import box_from_text
    from insonify.io.folders import result_file, result_folder
    from insonify.io.maps import map_file
    from insonify.io.mavlink import upload_mission
    from insonify.io.plans import qgroundcontrol, save_plan
    from insonify.planning.once import plan_next, turns_of
    from insonify.results.map import load_mapper
    from insonify.types import ScanPath

    begin("reading the map")
    told, place = _pose(from_), _place(datum, out, upload)
    entropy = entropy_settings(settings)
    file = map_file(map_)
    mapper = load_mapper(map_, memory_limit(memory))
    device = _device(file, sonar)
    origin_m = mapper.voxels.origin_m
    pose = told.relative_to(origin_m)
    if region is not None:
        box = box_from_text(region).relative_to(origin_m)
    else:
        box = _region(file, mapper.voxels)
    decision = plan_next(mapper, device.geometry, box, pose, entropy, waypoints)
    document = _describe(decision, pose, box, origin_m)
    if decision.path is not None:
        least_m = _least_clearance_m(file) if clearance is None else clearance
        way = way_there(mapper.voxels, pose, decision.path, least_m)
        document |= _describe_way(mapper.voxels, pose, way, decision.path) | {"speed_mps": speed}
        flown = ScanPath((*way[:-1], *turns_of(decision.path.waypoints)))
        document["waypoints"] = len(flown.waypoints)
        mission = None if place is None else qgroundcontrol(flown, place, speed)
        if out.suffix == ".plan":
            document["files"] = [out.name]
            with result_file(out, force=force) as scratch:
                scratch.write_text(_json(mission))
        else:
            with result_folder(out, force=force) as folder:
                document["files"] = save_plan(flown, folder.scratch, place, origin_m, speed)
                (folder.scratch / "decision.json").write_text(_json(document))
        if upload is not None and mission is not None:
            begin(f"sending to {upload}")
            document["uploaded_to"] = f"{upload}, {upload_mission(mission, upload)}"
    if picture is not None:
        _draw(picture, mapper.voxels, box, decision, (pose, *way) if decision.path else (pose,))
    _tell(document, out, as_json=as_json, placed=place is not None)


def _json(document: Any) -> str:
    return json.dumps(document, indent=2) + "\n"


def _place(datum: str | None, out: Path, upload: str | None) -> Datum | None:
    """Where the map's origin lies, if that is told.

    Raises:
        ConfigError: It is not, and an autopilot must know.
    """
    if datum is None and (upload is not None or out.suffix == ".plan"):
        what = "--upload" if upload is not None else out.name
        raise ConfigError(f"{what}: an autopilot takes places on the Earth; give a --datum")
    return None if datum is None else datum_from_text(datum)


def way_there(voxels: VoxelMap, pose: Pose, path: ScanPath, least_m: float) -> tuple[Pose, ...]:
    """The way to a scan's first pose, round what is mapped.

    Raises:
        GeometryError: There is none, or the scan itself comes too near.
    """
    from insonify.vehicle.autopilot.leading import lead_to

    lead = lead_to(voxels, pose, path, least_m)
    if lead.way is None:
        raise GeometryError(f"{lead.why}; start elsewhere (--from), or allow less (--clearance)")
    return lead.way


def _draw(
    picture: Path, voxels: VoxelMap, region: Box, decision: Decision, way: tuple[Pose, ...]
) -> None:
    from insonify.io.folders import write_file
    from insonify.report.plan_pictures import draw_plan

    write_file(picture, draw_plan(voxels, region, decision, way))
    tell(f"Picture: {picture}")


def _tell(document: dict[str, Any], out: Path, *, as_json: bool, placed: bool) -> None:
    """Say what came of it."""
    if as_json:
        say_json(document)
    else:
        say_listing(["what", "value"], plan_rows(document))
    if "start" not in document:
        tell("insonify: no scan is worth flying; no path was written")
        raise typer.Exit(EXIT_NOTHING)
    if document["clearance_m"] < 1.0:
        tell(
            f"insonify: warning: the way there or the scan comes within "
            f"{document['clearance_m']:g} m of an occupied voxel; look before it is flown"
        )
    if not placed:
        tell("insonify: no --datum, so no GeoJSON and no QGroundControl plan")
    tell(f"Path: {out}")


def _least_clearance_m(file: Path) -> float:
    """The clearance of the scan that made a map, or that which scans have by default."""
    from insonify.mission.setup import SurveySettings

    config = _scan_config(file)
    return (SurveySettings() if config is None else config.survey).clearance_m


def _pose(text: str) -> Pose:
    from insonify.types import Pose

    try:
        x, y, z, yaw = (float(word) for word in text.replace(",", " ").split())
    except ValueError as err:
        raise GeometryError(
            f"--from takes x, y, z in metres and yaw in degrees, as in '0 0 -15 90', not {text!r}"
        ) from err
    return Pose(x, y, z, yaw_rad=math.radians(yaw))


def entropy_settings(settings: list[str] | None) -> EntropySettings:
    """The entropy planner's settings, of those given one by one.

    Raises:
        ConfigError: One is not of the planner's, or makes no sense.
    """
    from insonify.config.layers import overlaid
    from insonify.config.settings import validated
    from insonify.planning.active import EntropySettings

    layers = single_layers(settings)
    for layer in layers:
        if set(layer) != {"entropy"} or not isinstance(layer["entropy"], dict):
            raise ConfigError(f"plan takes --set entropy.KEY=VALUE only, not {next(iter(layer))}")
    table = overlaid(layers).get("entropy", {})
    return validated(EntropySettings, table, prefix="entropy.")


def _device(file: Path, name: str | None) -> SonarDevice:
    """The sonar named, or else the one that made the map, as its folder tells."""
    from insonify.sonar.devices import named_device

    if name is not None:
        return named_device(name)
    if (file.parent / "sonar.toml").is_file():
        return named_device(str(file.parent / "sonar.toml"))
    config = _scan_config(file)
    if config is None:
        raise ConfigError(f"{file}: nothing beside it says what sonar will scan; name it (--sonar)")
    return config.sonar


def _region(file: Path, voxels: VoxelMap) -> Box:
    """The region of the map's result, or around what is occupied."""
    from insonify.errors import ResultError
    from insonify.mission.result import MapResult, ScanResult
    from insonify.results.files import load_result
    from insonify.types import Box

    try:
        result = load_result(file.parent)
    except ResultError:
        return voxels.around_occupied()
    if isinstance(result, MapResult | ScanResult) and result.region_m is not None:
        return Box.of(*result.region_m).relative_to(voxels.origin_m)
    return voxels.around_occupied()


def _scan_config(file: Path) -> Config | None:
    """The config of the scan that made a map, if it lies beside it."""
    from insonify.config.layers import read_layer
    from insonify.mission.setup import scenario_config

    if not (file.parent / "config.toml").is_file():
        return None
    table = read_layer(file.parent / "config.toml")
    if "scenario" not in table:
        return None
    return scenario_config(str(table["scenario"]), [table])


def _describe(
    decision: Decision, pose: Pose, region: Box, origin_m: tuple[float, float, float]
) -> dict[str, Any]:
    """A decision in the world's coordinates."""

    def world(place: Sequence[float]) -> list[float]:
        return [round(c + o, 4) for c, o in zip(place, origin_m, strict=True)]

    document: dict[str, Any] = {
        "from": [*world(pose.position_m), round(math.degrees(pose.yaw_rad), 6)],
        "region_m": [world(region.low_m), world(region.high_m)],
        "stop": decision.why_not,
    }
    look = decision.look
    if look is not None:
        document |= {
            "cluster_voxels": len(look.cluster.voxels_m),
            "cluster_centre_m": world(look.cluster.centre_m),
            "cluster_entropy_bits": round(look.cluster.entropy, 2),
            "candidates": len(look.candidates),
            "best_candidate": look.best,
            "best_share": round(float(look.h_cluster[look.best] / look.cluster.entropy), 4),
        }
    return document


def _describe_way(
    voxels: VoxelMap, pose: Pose, way: tuple[Pose, ...], path: ScanPath
) -> dict[str, Any]:
    """The scan, and the way there, in the world's coordinates."""
    from insonify.planning.once import clearance_m

    start, whole = path.waypoints[0], (pose, *way)
    place = [c + o for c, o in zip(start.position_m, voxels.origin_m, strict=True)]
    legs = zip(whole, way, strict=False)
    return {
        "start": [*(round(c, 4) for c in place), round(math.degrees(start.yaw_rad), 6)],
        "length_m": round(path.length_m, 4),
        "pings": len(path.waypoints),
        "transit_m": round(sum(math.dist(a.position_m, b.position_m) for a, b in legs), 4),
        "detour": len(way) > 1,
        "clearance_m": round(clearance_m(voxels, (*whole, *path.waypoints)), 3),
    }
