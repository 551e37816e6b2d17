"""The page: a slider over the pings, and layers of what was known and done at each of them."""

from __future__ import annotations

import atexit
import contextlib
import errno
import io
import socket
import threading
import time
from typing import Any

import numpy as np

from insonify.errors import OutputError
from insonify.extras import optional
from insonify.frames import world_from_sonar
from insonify.mission.loop import Step
from insonify.mission.run import Run
from insonify.types import Float64, Ping
from insonify.view import layers, shapes, words
from insonify.view.guard import guarded
from insonify.view.story import Story

_REST_S, _STEP_S = 0.05, 0.15
"""Between two drawings, and between two pings when playing."""
_PORTS_TRIED, _IMAGE_WIDTH = 100, 560
_NOTHING = (-1, -1, -1)
_LAYERS = {
    "occupied": ("occupied voxels", True),
    "elsewhere": ("occupied, outside", False),
    "undecided": ("entropy", False),
    "cluster": ("largest cluster", False),
    "object": ("true object", False),
    "seabed": ("true seabed", False),
    "path": ("trajectory", True),
    "sonar": ("sonar", True),
    "candidates": ("candidates", True),
}


class Page:
    """A web server that shows a story, and follows it while it grows.

    Other web pages that a browser has open cannot read it (`insonify.view.guard`).
    """

    def __init__(self, story: Story, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Start serving.

        Args:
            story: What to show.
            host: Address to listen at; 0.0.0.0 is every one.
            port: The first free one from here on.

        Raises:
            MissingExtraError: The package viser is not installed.
            OutputError: There is no such address here, or no free port.
        """
        viser = optional("viser", "view", "the view in the browser")
        port = _free_port(host, port)
        with (
            contextlib.redirect_stdout(io.StringIO()),  # where it announces itself
            guarded(host),
        ):
            self._server = viser.ViserServer(host=host, port=port, label="insonify", verbose=False)
        atexit.unregister(self._server.stop)  # which says so on stdout
        self.url = f"http://{host}:{self._server.get_port()}"
        self._story = story
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._shown = _NOTHING
        self._world_drawn = self._camera_set = False
        self._build()
        story.changed = self._wake.set
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._wake.set()
        self._thread.start()

    def watch(self, run: Run, step: Step) -> None:
        """Show a step of a run that is going on."""
        self._story.watch(run, step)

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._wake.set()
        self._thread.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _build(self) -> None:
        gui, scene = self._server.gui, self._server.scene
        scene.set_up_direction("+z")
        layers.light(scene)
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._slider = gui.add_slider("ping", min=0, max=1, step=1, initial_value=0, visible=False)
        self._play = gui.add_checkbox("play", initial_value=False, visible=False)
        self._text = gui.add_html("")
        self._image = gui.add_html("", visible=False)
        self._boxes, self._nodes = {}, {}
        with gui.add_folder("Layers"):
            for name, (label, shown) in _LAYERS.items():
                self._nodes[name] = scene.add_frame(f"/{name}", show_axes=False, visible=shown)
                self._boxes[name] = gui.add_checkbox(label, initial_value=shown)
                self._boxes[name].on_update(self._toggled(name))
            gui.add_html(
                words.colour_bar("viridis", "0.5", "1", "probability of an occupied voxel")
                + words.colour_bar("magma", "0.5", "1", "entropy of an undecided voxel, bits")
            )
        self._decision = gui.add_folder("Decision", visible=False)
        with self._decision:
            self._candidates = gui.add_html("")
        self._slider.on_update(lambda event: self._wake.set())
        self._play.on_update(lambda event: self._wake.set())

    def _toggled(self, name: str) -> Any:
        def toggle(event: object) -> None:
            self._nodes[name].visible = self._boxes[name].value
            self._shown = _NOTHING  # a layer is drawn when it is looked at
            self._wake.set()

        return toggle

    def _run(self) -> None:
        """Draw what is asked for last, for as long as the page is open."""
        while not self._closed.is_set():
            woken = self._wake.wait(_STEP_S if self._play.value else None)
            self._wake.clear()
            if self._closed.is_set():
                return
            if not woken:
                self._advance()
            with self._server.atomic():
                self._draw()
            time.sleep(_REST_S)

    def _advance(self) -> None:
        if self._slider.value < self._slider.max:
            self._slider.value += 1
        else:
            self._play.value = False

    def _draw(self) -> None:
        story = self._story
        count = len(story.moments)
        self._draw_world()
        self._grow(count)
        number = int(self._slider.value) if count else 0
        state = (number, count, len(story.decisions) + bool(story.end))
        if state == self._shown:
            return
        self._shown = state
        self._offer_layers()
        self._text.content = words.describe(story, number)
        self._draw_map(number)
        if number:
            self._draw_ping(number)
        self._draw_decision(number)

    def _grow(self, count: int) -> None:
        """Let the slider reach the last ping, and stay at the end if it is there."""
        if count == 0 or (self._slider.visible and self._slider.max == count):
            return
        follows = not self._slider.visible or self._slider.value == self._slider.max
        self._slider.max = max(count, 2)
        self._slider.min = 1
        if follows:
            self._slider.value = count
        self._slider.visible = self._play.visible = count > 1

    def _draw_world(self) -> None:
        story = self._story
        if story.world and not self._world_drawn:
            self._world_drawn = True
            layers.draw_world(self._server.scene, story.world)
        if not self._camera_set and (story.region is not None or story.moments):
            self._camera_set = True
            camera = self._server.initial_camera
            camera.position, camera.look_at = shapes.overview(*self._extent())

    def _extent(self) -> tuple[Float64, Float64]:
        """The corners of what the page shows: the area, or else the space before the sonar."""
        story = self._story
        if story.region is not None:
            return np.array(story.region.low_m), np.array(story.region.high_m)
        moment = story.moments[0]
        world = world_from_sonar(moment.pose or layers.AT_ORIGIN, moment.geometry.mount)
        ends = shapes.fan_edges(moment.geometry).reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]
        return ends.min(axis=0), ends.max(axis=0)

    def _offer_layers(self) -> None:
        """Boxes for what there is to be seen."""
        story = self._story
        mapped = story.maps.at(len(story.moments)) is not None
        there = {
            "object": bool(story.world),
            "seabed": bool(story.world),
            "cluster": bool(story.decisions),
            "candidates": bool(story.decisions),
            "path": len(story.moments) > 1,
            "sonar": bool(story.moments),
        }
        for name, box in self._boxes.items():
            shown = there.get(name, mapped)
            if box.visible != shown:
                box.visible = shown

    def _draw_map(self, number: int) -> None:
        found = self._story.maps.at(number)
        if found is None:
            return
        scene, picture = self._server.scene, found[1]
        if self._boxes["occupied"].value:
            layers.draw_cubes(scene, "/occupied/cubes", picture.occupied)
        if self._boxes["elsewhere"].value:
            layers.draw_cubes(scene, "/elsewhere/cubes", picture.elsewhere)
        if self._boxes["undecided"].value:
            layers.draw_entropy(scene, picture.undecided)

    def _draw_ping(self, number: int) -> None:
        story = self._story
        kept = story.images.at(number)
        assert kept is not None
        taken, grey = kept
        ping = Ping(grey.astype(np.float32) / 255.0, story.moments[taken - 1].geometry)
        picture, extent = shapes.fan_picture(ping, _IMAGE_WIDTH)
        note = "" if taken == number else f"<br>image of ping {taken}, the last one kept"
        self._image.content = words.image(picture, note)
        self._image.visible = True
        layers.draw_sonar(self._server.scene, story.moments[number - 1], picture, extent)
        layers.draw_paths(self._server.scene, story.moments[:number])

    def _draw_decision(self, number: int) -> None:
        decision = self._story.decision_at(number)
        if decision is None:
            return
        waypoints = decision.path.waypoints if decision.path is not None else ()
        layers.draw_plan(self._server.scene, waypoints)
        layers.draw_look(self._server.scene, decision.look)
        self._decision.visible = decision.look is not None or decision.stop is not None
        self._candidates.content = words.reasons(decision)


def _free_port(host: str, port: int) -> int:
    """The first port from here on that nobody listens at."""
    for candidate in range(port, min(port + _PORTS_TRIED, 65536)):
        try:
            with socket.create_server((host, candidate)):
                return candidate
        except OSError as err:
            if err.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise OutputError(
                    f"the view cannot be served at {host}:{candidate} "
                    f"({err.strerror or err}); give another --host"
                ) from err
    raise OutputError(
        f"the view cannot be served at {host}: no free port from {port} on; give another --port"
    )
