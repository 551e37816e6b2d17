"""Mapping while pings come in: from the robot's bus, or from a recording that is played."""

from __future__ import annotations

import json
import math
import signal
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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
from insonify.cli.views import HostOption, hold_open, page_and_story
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.cli.progress import Bar
    from insonify.io.recordings.recording import Reading
    from insonify.live.counts import Counts
    from insonify.live.foxglove import FoxgloveServer
    from insonify.live.publishing import Publisher, Send
    from insonify.live.running import Order
    from insonify.live.session import Event, Session, Watcher
    from insonify.live.showing import Narrator
    from insonify.mission.result import MapResult
    from insonify.planning.active import EntropySettings
    from insonify.types import Box

VIEW_PORT = 8080
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
ServedPortOption = Annotated[
    int | None,
    typer.Option(
        min=1, max=65535, help="Of --view, the first to try (8080), or of --foxglove (8765)."
    ),
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
    view: Annotated[
        bool, typer.Option("--view", help="Show pings and map in the browser as they come.")
    ] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve what is sent to Foxglove too.")
    ] = False,
    host: HostOption = "127.0.0.1",
    port: ServedPortOption = None,
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
    from insonify.io.recordings import open_recording
    from insonify.live.planning import Desk, Pilot
    from insonify.live.publishing import Publisher
    from insonify.live.running import Order

    if rate is not None and (from_ is None or not 0.0 < rate < 1e6):
        raise ConfigError(f"--rate takes a factor above 0, and a recording (--from), not {rate:g}")
    entropy, mapping = _entropy_apart(settings)
    full = map_config(voxel, absolute(mapper), mapping, config)
    box = box_from_text(region) if region is not None else None
    folder = out or unused_folder(Path("insonify-runs") / "live")
    if from_ is not None and idle is not None:
        raise ConfigError("--idle is for the bus; a recording ends by itself (--from)")
    if port is not None and view == foxglove:
        raise ConfigError("--port is where --view or --foxglove serves; give it with one of them")
    pilot = Pilot(box, entropy, waypoints, clearance) if plan else None
    limit = memory_limit(memory)
    how = [to_toml(full, "A session"), repr(reading), *(["on disk"] if limit else [])]
    job = "" if from_ is not None else "\n".join(how)
    order = Order(full, box, folder, force, limit, job)
    if from_ is not None and not from_.exists():
        open_recording(from_)  # says so, before an address is told
    title = folder.name if from_ is None else from_.name
    with (
        _showing(title, box, host, port, wanted=view) as shown,
        _serving(host, port, wanted=foxglove) as server,
    ):
        served = {} if shown is None else {"view": shown[0]}
        served |= {} if server is None else {"foxglove": server.url}
        sending: list[Send] = [] if server is None else [server.send]
        publisher = Publisher(sending, pilot, radius)
        watchers = [] if shown is None else [shown[1].watch]
        watchers += [] if server is None else [server.watch]
        watchers += [publisher.watch]
        out_ = _Out(served, as_json)
        if from_ is None:
            _live_on_bus(order, reading, publisher, watchers, idle, out_)
            return
        publisher.desk, publisher.plans_at_end = Desk(beside=False), True
        _live_from(from_, rate, reading, order, publisher, watchers, out_)
        if shown is not None:
            tell("insonify: the view stays open until Ctrl-C", flush=True)
            hold_open()


@dataclass(frozen=True)
class _Out:
    """How a session is told of: the addresses that are served, and whether as JSON."""

    served: dict[str, str]
    as_json: bool


@contextmanager
def _showing(
    title: str, region: Box | None, host: str, port: int | None, *, wanted: bool
) -> Iterator[tuple[str, Narrator] | None]:
    """The address of a page of a session, and who tells it, if one is wanted."""
    if not wanted:
        yield None
        return
    page, story = page_and_story(title, host, VIEW_PORT if port is None else port, beside=True)
    try:
        from insonify.live.showing import Narrator

        yield page.url, Narrator(page, story, region)
    finally:
        page.close()


@contextmanager
def _serving(host: str, port: int | None, *, wanted: bool) -> Iterator[FoxgloveServer | None]:
    """A server for Foxglove, if one is wanted."""
    if not wanted:
        yield None
        return
    from insonify.live.foxglove import PORT, FoxgloveServer

    server = FoxgloveServer(host, PORT if port is None else port)
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
    out: _Out,
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
        source = heard(bus, poser, publisher, math.inf if idle_s is None else idle_s)
        result, folder = run_session(order, poser, source, watchers, ended)
    _tell(result, folder, poser.counts, out)


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
    publisher: Publisher,
    watchers: Sequence[Watcher],
    out: _Out,
) -> None:
    """Play a recording into a session."""
    from insonify.io.recordings.recording import RecordingWarning
    from insonify.live.counts import Counts
    from insonify.live.played import open_played, paced
    from insonify.live.running import run_session

    played = open_played(path, reading)
    for doubt in played.doubts:
        warnings.warn(f"{path}: {doubt}", RecordingWarning, stacklevel=2)
    poser = played.poser(Counts())
    with (
        interruptible(_ENDING, signal.SIGINT, signal.SIGTERM) as ended,
        progress(path.name, played.count) as bar,
    ):
        source = publisher.requests_heard(paced(played.messages(), rate))
        result, folder = run_session(order, poser, source, [*watchers, _shown(bar)], ended)
    _tell(result, folder, poser.counts, out)
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
        sent, unknown = publish_all(
            bus, paced(played.messages(), rate), ended, lambda n: bar.tell(f"{n} messages")
        )
    for topic, kind in unknown.items():
        tell(f"insonify: {topic} was not published: {kind} has no definition in {file}")
    tell(f"insonify: {sent} messages of {file} were published in DDS domain {bus.domain}")
    if ended():
        raise typer.Exit(EXIT_INTERRUPTED)


def _shown(bar: Bar) -> Watcher:
    """A bar over the pings."""

    def watch(session: Session, event: Event) -> None:
        counts = session.counts
        bar.show(counts.pings, note=f"{counts.mapped} mapped, {session.poser.waiting} waiting")

    return watch


def _tell(result: MapResult | None, folder: Path, counts: Counts, out: _Out) -> None:
    """Say what came of a session."""
    from insonify.live.leaving import ACCOUNT

    told = counts.to_json()
    if out.as_json:
        plans = json.loads((folder / ACCOUNT).read_text()).get("plans") if result else None
        document = {"messages": told, **out.served} | ({"plans": plans} if plans else {})
        say_json(document | ({} if result is None else {"map": result.to_json()}), flush=True)
    else:
        rows = [[key.replace("_", " "), str(value)] for key, value in told.items() if value]
        say_listing(["what", "value"], rows + ([] if result is None else map_rows(result)))
    if result is None:
        where = f"; what was recorded is in {folder}" if counts.pings else ""
        tell(f"insonify: no ping was mapped, so there is no map{where}")
        raise typer.Exit(EXIT_NOTHING)
    print_report(folder)
