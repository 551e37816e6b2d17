"""What is in a recording, and maps from recordings."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.root import JsonOption, app, print_listing

if TYPE_CHECKING:
    from insonify.io.recordings.recording import Reading

SonarOption = Annotated[
    str | None,
    typer.Option(
        "--sonar",
        metavar="NAME|FILE.toml",
        help="The device, for what the recording does not say of it; see: sonars",
    ),
]
PosesOption = Annotated[
    Path | None, typer.Option("--poses", metavar="FILE", help="Poses in TUM format.")
]
OffsetOption = Annotated[
    float,
    typer.Option("--clock-offset", metavar="S", help="Added to ping times to find their poses."),
]
SonarTopicOption = Annotated[
    str | None, typer.Option("--sonar-topic", metavar="TOPIC", help="Of a bag: the pings.")
]
PoseTopicOption = Annotated[
    str | None, typer.Option("--pose-topic", metavar="TOPIC", help="Of a bag: the poses.")
]


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: file or folder.")],
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Write its middle ping in fan view.")
    ] = None,
    sonar: SonarOption = None,
    poses: PosesOption = None,
    clock_offset: OffsetOption = 0.0,
    sonar_topic: SonarTopicOption = None,
    pose_topic: PoseTopicOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say what is in a recording: ARIS, Oculus, arrays, images, bags."""
    from insonify.io.recordings import open_recording
    from insonify.io.recordings.summary import summarise

    reading = _reading(sonar, poses, clock_offset, sonar_topic, pose_topic)
    summary, middle = summarise(open_recording(file, reading))
    if picture is not None and middle is not None:
        from insonify.io.folders import write_file
        from insonify.report.pictures import draw_fan

        title = f"{file.name}, ping {summary['pings'] // 2 + 1} of {summary['pings']}"
        write_file(picture, draw_fan(middle, title))
        print(f"Picture: {picture}", file=sys.stderr)
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        print_listing(["what", "value"], _rows(summary))


def _reading(
    sonar: str | None,
    poses: Path | None,
    clock_offset_s: float,
    sonar_topic: str | None,
    pose_topic: str | None,
) -> Reading:
    from insonify.io.recordings.recording import Reading
    from insonify.sonar.devices import named_device

    device = named_device(sonar) if sonar is not None else None
    return Reading(device, poses, clock_offset_s, sonar_topic, pose_topic)


def _rows(summary: dict[str, Any]) -> list[list[str]]:
    rows = [[key, summary[key]] for key in ("file", "format", "pings")]
    if summary["clock"]:
        rows += [["first ping, s", summary["first_s"]], ["duration, s", summary["duration_s"]]]
    else:
        rows += [["clock", "none: pings count from 0"]]
    for fan in summary["fans"]:
        kind = f"{fan['beams']} beams x {fan['bins']} bins"
        rows.append(["fan" if len(summary["fans"]) == 1 else f"fan of {fan['pings']} pings", kind])
        rows.append(["  ranges, m", f"{fan['range_min_m']:.6g} to {fan['range_max_m']:.6g}"])
        rows.append(["  bin, m", f"{fan['bin_m']:.6g}"])
        low, high = fan["bearings_deg"]
        rows.append(["  edges, deg to starboard", f"{low:.2f} to {high:.2f}"])
        rows.append(["  elevation, deg", f"{fan['elevation_deg']:g}{_assumed(summary)}"])
        rows.append(["  mount roll, pitch, yaw, deg", str(fan["mount_rpy_deg"])])
    rows.append(["pixels, of 1", f"mean {summary['pixel_mean']}, most {summary['pixel_max']}"])
    path = f", {summary['path_m']:.3f} m of path" if summary["poses"] else ""
    rows.append(["poses", f"{summary['poses']} of {summary['pings']} pings{path}"])
    says = {key: value for key, value in summary["says"].items() if key != "elevation_assumed"}
    says["source of poses"] = says.pop("poses")
    rows += [[key.replace("_", " "), value] for key, value in says.items()]
    return [[str(key), str(value)] for key, value in rows]


def _assumed(summary: dict[str, Any]) -> str:
    return " (assumed; --sonar says better)" if summary["says"].get("elevation_assumed") else ""
