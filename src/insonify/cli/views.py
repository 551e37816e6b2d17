"""Runs, maps and recordings in the browser."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.printing import say_json, tell
from insonify.cli.progress import begin, progress
from insonify.cli.reading import takes_reading
from insonify.cli.recordings import RegionOption, VoxelOption, box_from_text, map_config
from insonify.cli.root import (
    JsonOption,
    MemoryOption,
    SetOption,
    app,
    interruptible,
    memory_limit,
)

if TYPE_CHECKING:
    from insonify.view.page import Page
    from insonify.view.story import Story

HostOption = Annotated[str, typer.Option(help="Address to serve at; 0.0.0.0 for other machines.")]
PortOption = Annotated[int, typer.Option(min=1, max=65535, help="First port to try.")]


@app.command()
@takes_reading
def view(
    path: Annotated[
        Path, typer.Argument(metavar="RUN|MAP|RECORDING", help="Result folder, map or recording.")
    ],
    settings: SetOption = None,
    region: RegionOption = None,
    voxel: VoxelOption = None,
    memory: MemoryOption = None,
    reading: Any = None,
    host: HostOption = "127.0.0.1",
    port: PortOption = 8080,
    as_json: JsonOption = False,
) -> None:
    """Show a run, a map or a recording in the browser, ping by ping."""
    begin("starting the view")
    from insonify.view.server import Server

    server = Server(host, port)
    address = f"View: {server.url}  (Ctrl-C ends it)"
    plain = path.exists() and all(option is None for option in (settings, voxel, region, memory))
    try:
        if plain and not as_json:  # at once, as what follows takes a second to import
            tell(address, flush=True)
            begin("opening")
        from insonify.view.page import Page
        from insonify.view.sources import open_story

        how = map_config(voxel, None, settings)
        box = box_from_text(region) if region is not None else None
        told = open_story(path, reading, how, box, memory_limit(memory))
        page = Page(told.story, server=server)
    except BaseException:
        server.close()
        raise
    if as_json:
        say_json({"url": page.url, "pings": told.count}, indent=None, flush=True)
    elif not plain:  # there was more that could be wrong
        tell(address, flush=True)
    try:
        with interruptible("closing the view") as interrupted:
            with progress("reading") as bar:
                told.go_on(
                    lambda done, count: bar.show(done, count, path.name, f"{done} of {count}"),
                    interrupted,
                )
            while not interrupted():
                time.sleep(0.1)
    finally:
        page.close()


def live_page(title: str) -> Page:
    """A page that waits for a run to be told to its story."""
    page, _ = page_and_story(title)
    return page


def page_and_story(
    title: str, host: str = "127.0.0.1", port: int = 8080, *, beside: bool = False
) -> tuple[Page, Story]:
    """A page whose address is told at once, and its story, which is yet to be told.

    Args:
        title: Of the story.
        host: Address to serve at.
        port: The first to try.
        beside: See `Page`.
    """
    from insonify.view.server import Server

    server = Server(host, port)
    tell(f"View: {server.url}", flush=True)
    from insonify.view.page import Page
    from insonify.view.story import Story

    story = Story(title)
    return Page(story, server=server, beside=beside), story


def hold_open() -> None:
    """Wait until Ctrl-C or SIGTERM while a page is looked at."""
    signals = signal.SIGINT, signal.SIGTERM
    with interruptible("closing the view", *signals) as interrupted:
        while not interrupted():
            time.sleep(0.1)


def serve(page: Page) -> None:
    """Keep a page open until Ctrl-C."""
    hold_open()
    page.close()
