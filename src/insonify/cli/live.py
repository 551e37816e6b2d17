"""Mapping while pings come in: from the robot's bus, or from a recording that is played."""

from __future__ import annotations

import math
import signal
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say_json, say_listing, tell
from insonify.cli.progress import progress
from insonify.cli.reading import takes_reading
from insonify.cli.recordings import RegionOption, VoxelOption, box_from_text, map_config, map_rows
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    EXIT_NOTHING,
    ConfigOption,
    ForceOption,
    JsonOption,
    MapperOption,
    MemoryOption,
    OutOption,
    SetOption,
    absolute,
    app,
    interruptible,
    memory_limit,
    print_report,
)
from insonify.cli.views import HostOption, PortOption
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.cli.progress import Bar
    from insonify.io.recordings.recording import Reading
    from insonify.live.counts import Counts
    from insonify.live.foxglove import FoxgloveServer
    from insonify.live.publishing import Publisher, Send
    from insonify.live.running import Order
    from insonify.live.session import Event, Session, Watcher
    from insonify.mission.result import MapResult
    from insonify.planning.active import EntropySettings

RateOption = Annotated[
    float | None,
    typer.Option("--rate", metavar="X", help="So many times as fast as it was recorded."),
]
PlanOption = Annotated[
    bool,
    typer.Option("--plan", help="Send the next scan's path after each, and on request."),
]
RadiusOption = Annotated[
    float,
    typer.Option("--radius", min=0.1, metavar="M", help="The map is sent so far around."),
]
IdleOption = Annotated[
    float | None,
    typer.Option("--idle", min=0.1, metavar="S", help="End when nothing has come for so long."),
]
ClearanceOption = Annotated[
    float, typer.Option(min=0.0, metavar="M", help="Least, of a path to what is mapped.")
]
WaypointsOption = Annotated[int, typer.Option(min=1, max=10000, help="Of a scan.")]
_ENDING = "writing what is mapped; once more leaves it for the next start"


@app.command()
@takes_reading
def live(
    from_: Annotated[
        Path | None,
        typer.Option("--from", metavar="RECORDING", help="Play this instead of hearing the bus."),
    ] = None,
    rate: RateOption = None,
    mapper: MapperOption = None,
    voxel: VoxelOption = None,
    region: RegionOption = None,
    memory: MemoryOption = None,
    plan: PlanOption = False,
    waypoints: WaypointsOption = 40,
    clearance: ClearanceOption = 0.4,
    radius: RadiusOption = 20.0,
    idle: IdleOption = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve what is sent to Foxglove too.")
    ] = False,
    host: HostOption = "127.0.0.1",
    port: PortOption = 8765,
    reading: Any = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Map pings as they come, from the robot's bus (ROS 2's DDS) or a recording that is played."""
    from insonify.config.toml import to_toml
    from insonify.io.folders import unused_folder
    from insonify.live.planning import Pilot
    from insonify.live.publishing import Publisher
    from insonify.live.running import Order

    if rate is not None and (from_ is None or not 0.0 < rate < 1e6):
        raise ConfigError(f"--rate takes a factor above 0, and a recording (--from), not {rate:g}")
    entropy, mapping = _entropy_apart(settings)
    full = map_config(voxel, absolute(mapper), mapping, config)
    box = box_from_text(region) if region is not None else None
    folder = out or unused_folder(Path("insonify-runs") / "live")
    if from_ is not None and (plan or idle is not None):
        raise ConfigError("--plan and --idle are for the bus; a recording is not steered (--from)")
    pilot = Pilot(box, entropy, waypoints, clearance) if plan else None
    limit = memory_limit(memory)
    how = [to_toml(full, "A session"), repr(reading), *(["on disk"] if limit else [])]
    job = "" if from_ is not None else "\n".join(how)
    order = Order(full, box, folder, force, limit, job)
    with _serving(host, port, wanted=foxglove) as server:
        sending: list[Send] = [] if server is None else [server.send]
        publisher = Publisher(sending, pilot, radius)
        watchers = [publisher.watch] if server is None else [publisher.watch, server.watch]
        if from_ is None:
            _live_on_bus(order, reading, publisher, watchers, idle, as_json=as_json)
        else:
            _live_from(from_, rate, reading, order, watchers, as_json=as_json)


@contextmanager
def _serving(host: str, port: int, *, wanted: bool) -> Iterator[FoxgloveServer | None]:
    """A server for Foxglove, if one is wanted."""
    if not wanted:
        yield None
        return
    from insonify.live.foxglove import FoxgloveServer

    server = FoxgloveServer(host, port)
    tell(f"Foxglove: {server.url}", flush=True)
    try:
        yield server
    finally:
        server.close()


def _live_on_bus(
    order: Order,
    reading: Reading,
    publisher: Publisher,
    watchers: Sequence[Watcher],
    idle_s: float | None,
    *,
    as_json: bool,
) -> None:
    """Map what comes over the bus until Ctrl-C, SIGTERM or silence."""
    from insonify.live.bus import Bus
    from insonify.live.counts import Counts
    from insonify.live.poser import Poser
    from insonify.live.publishing import ANSWERS
    from insonify.live.running import load_kernels, run_session
    from insonify.live.wiring import counting_losses, heard

    if reading.poses is not None:
        raise ConfigError("--poses is a file; on the bus poses come on a topic (--pose-topic)")
    poser = Poser(reading, Counts())
    load_kernels(order.config)
    with (
        Bus() as bus,
        interruptible(_ENDING, signal.SIGINT, signal.SIGTERM) as ended,
        progress("listening") as bar,
    ):
        tell(f"insonify: listening in DDS domain {bus.domain}; Ctrl-C ends it", flush=True)
        if not publisher.send:
            publisher.listens = lambda topic: bus.listeners(topic) > 0
        publisher.send.append(bus.publish)
        for topic, kind in ANSWERS.items():
            bus.writer(topic, kind)
        watchers = [*watchers, counting_losses(bus), _shown(bar)]
        source = heard(bus, reading, publisher, math.inf if idle_s is None else idle_s)
        result, folder = run_session(order, poser, source, watchers, ended)
    _tell(result, folder, poser.counts, as_json=as_json)


def _entropy_apart(settings: list[str] | None) -> tuple[EntropySettings, list[str]]:
    """The planner's settings of those given one by one, and the others."""
    from insonify.cli.plans import entropy_settings

    own = [text for text in settings or [] if text.startswith("entropy.")]
    return entropy_settings(own), [text for text in settings or [] if text not in own]


def _live_from(
    path: Path,
    rate: float | None,
    reading: Reading,
    order: Order,
    watchers: Sequence[Watcher],
    *,
    as_json: bool,
) -> None:
    """Play a recording into a session."""
    from insonify.io.recordings.recording import RecordingWarning
    from insonify.live.counts import Counts
    from insonify.live.played import open_played, paced
    from insonify.live.poser import Poser
    from insonify.live.running import run_session

    played = open_played(path, reading)
    for doubt in played.doubts:
        warnings.warn(f"{path}: {doubt}", RecordingWarning, stacklevel=2)
    poser = Poser(played.reading, Counts(), played.settled)
    with (
        interruptible(_ENDING, signal.SIGINT, signal.SIGTERM) as ended,
        progress(path.name, played.count) as bar,
    ):
        source = paced(played.messages(), rate)
        result, folder = run_session(order, poser, source, [*watchers, _shown(bar)], ended)
    _tell(result, folder, poser.counts, as_json=as_json)
    if ended():
        raise typer.Exit(EXIT_INTERRUPTED)


@app.command()
@takes_reading
def play(
    file: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording: file or folder.")],
    rate: RateOption = None,
    wait: Annotated[
        float, typer.Option("--wait", min=0.0, metavar="S", help="For someone to listen, at most.")
    ] = 30.0,
    reading: Any = None,
) -> None:
    """Publish a recording on the bus: a bag's own messages, or those that its pings would be."""
    from insonify.live.bus import Bus
    from insonify.live.played import open_played, paced
    from insonify.live.wiring import await_listener, publish_all

    rate = 1.0 if rate is None else rate
    if not 0.0 < rate < 1e6:
        raise ConfigError(f"--rate takes a factor above 0, not {rate:g}")
    played = open_played(file, reading)
    with (
        Bus() as bus,
        interruptible("ending", signal.SIGINT, signal.SIGTERM) as ended,
        progress(file.name) as bar,
    ):
        if not await_listener(bus, played.topics, played.sonar, wait, ended) and not ended():
            tell(f"insonify: nobody listens to {played.sonar} here; it is played all the same")
        sent = publish_all(
            bus, paced(played.messages(), rate), ended, lambda n: bar.tell(f"{n} messages")
        )
    tell(f"insonify: {sent} messages of {file} were published in DDS domain {bus.domain}")
    if ended():
        raise typer.Exit(EXIT_INTERRUPTED)


def _shown(bar: Bar) -> Watcher:
    """A bar over the pings."""

    def watch(session: Session, event: Event) -> None:
        counts = session.counts
        bar.show(counts.pings, note=f"{counts.mapped} mapped, {session.poser.waiting} waiting")

    return watch


def _tell(result: MapResult | None, folder: Path, counts: Counts, *, as_json: bool) -> None:
    """Say what came of a session."""
    told = counts.to_json()
    if as_json:
        say_json({"messages": told} | ({} if result is None else {"map": result.to_json()}))
    else:
        rows = [[key.replace("_", " "), str(value)] for key, value in told.items() if value]
        say_listing(["what", "value"], rows + ([] if result is None else map_rows(result)))
    if result is None:
        where = f"; what was recorded is in {folder}" if counts.pings else ""
        tell(f"insonify: no ping was mapped, so there is no map{where}")
        raise typer.Exit(EXIT_NOTHING)
    print_report(folder)
