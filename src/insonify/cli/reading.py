"""What a user may say of a recording, the same for every command that reads one."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.root import numbers_of
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.io.recordings.recording import Reading
    from insonify.types import Pose

SonarOption = Annotated[
    str | None,
    typer.Option(
        "--sonar",
        metavar="NAME|FILE.toml",
        help="The device, for what the recording does not say of it; see: sonars",
    ),
]
PosesOption = Annotated[
    Path | None, typer.Option("--poses", metavar="FILE", help="Poses in TUM format, or .tlog.")
]
OffsetOption = Annotated[
    float,
    typer.Option("--clock-offset", metavar="S", help="Added to ping times to find their poses."),
]
GapOption = Annotated[
    float | None,
    typer.Option(
        "--max-gap",
        metavar="S",
        help="Pings between poses further apart have none; by default five times the poses' own "
        "interval, a second at least.",
        show_default=False,
    ),
]
ScaleOption = Annotated[
    float | None,
    typer.Option(
        "--scale",
        metavar="VALUE",
        help="The pixel that means the loudest; by default the largest of a whole number's type, "
        "and 1 of floating ones.",
        show_default=False,
    ),
]
SonarTopicOption = Annotated[
    str | None, typer.Option("--sonar-topic", metavar="TOPIC", help="Of a bag: the pings.")
]
PoseTopicOption = Annotated[
    str | None, typer.Option("--pose-topic", metavar="TOPIC", help="Of a bag: the poses.")
]

MountOption = Annotated[
    str | None,
    typer.Option(
        "--mount",
        metavar="'X Y Z ROLL PITCH YAW'",
        help="The sonar on the vehicle: metres forward, to port, up; degrees, a positive pitch "
        "looks down, a positive yaw to port. Overrules the recording.",
    ),
]
BeamsOption = Annotated[
    str | None,
    typer.Option(
        "--beams",
        metavar="port-to-starboard|starboard-to-port|auto",
        help="Which way the columns run; auto: as the recording says, or as is assumed.",
    ),
]
ConventionOption = Annotated[
    str | None,
    typer.Option(
        "--convention",
        metavar="enu|ned",
        help="Axes of the poses; by default as their frames are named, else east, north, up.",
    ),
]

_OPTIONS: dict[str, tuple[Any, Any]] = {
    "sonar": (SonarOption, None),
    "poses": (PosesOption, None),
    "clock_offset_s": (OffsetOption, 0.0),
    "sonar_topic": (SonarTopicOption, None),
    "pose_topic": (PoseTopicOption, None),
    "max_gap_s": (GapOption, None),
    "full_scale": (ScaleOption, None),
    "mount": (MountOption, None),
    "beams": (BeamsOption, None),
    "convention": (ConventionOption, None),
}


def takes_reading(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameter ``reading`` is made of all these options, in its place."""
    own = inspect.signature(command, eval_str=True, globals=command.__globals__)

    @wraps(command)
    def with_options(**given: Any) -> None:
        said = {name: given.pop(name) for name in _OPTIONS}
        command(reading=_reading(**said), **given)

    parameters: list[inspect.Parameter] = []
    for name, parameter in own.parameters.items():
        if name != "reading":
            parameters.append(parameter)
            continue
        parameters += [
            inspect.Parameter(option, parameter.kind, default=default, annotation=kind)
            for option, (kind, default) in _OPTIONS.items()
        ]
    with_options.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    with_options.__annotations__ = {one.name: one.annotation for one in parameters}
    del with_options.__wrapped__
    return with_options


def _reading(
    sonar: str | None,
    poses: Path | None,
    clock_offset_s: float,
    sonar_topic: str | None,
    pose_topic: str | None,
    max_gap_s: float | None,
    full_scale: float | None,
    mount: str | None,
    beams: str | None,
    convention: str | None,
) -> Reading:
    """What the options say of a recording."""
    from insonify.io.recordings.recording import Reading
    from insonify.sonar.devices import named_device

    device = named_device(sonar) if sonar is not None else None
    if not math.isfinite(clock_offset_s):
        raise ConfigError(f"--clock-offset takes seconds, not {clock_offset_s}")
    if max_gap_s is not None and not max_gap_s > 0.0:
        raise ConfigError(f"--max-gap takes seconds above 0, not {max_gap_s:g}")
    if full_scale is not None and not 0.0 < full_scale < math.inf:
        raise ConfigError(f"--scale takes the value of the loudest echo, not {full_scale:g}")
    return Reading(
        device=device,
        poses=poses,
        clock_offset_s=clock_offset_s,
        sonar_topic=sonar_topic,
        pose_topic=pose_topic,
        max_gap_s=max_gap_s,
        full_scale=full_scale,
        mount=None if mount is None else _mount(mount),
        beams=None if beams == "auto" else beams,
        convention=convention,
    )


def _mount(text: str) -> Pose:
    from insonify.types import Pose

    x, y, z, *degrees = numbers_of("--mount", text, 6)
    if max(map(abs, degrees)) > 360.0 or max(abs(x), abs(y), abs(z)) > 1000.0:
        raise ConfigError(
            "--mount takes metres forward, to port and up, then degrees of roll, pitch and yaw, as "
            f"in '0.3 0 -0.1 0 20 0', not {text!r}"
        )
    return Pose(x, y, z, *map(math.radians, degrees))
