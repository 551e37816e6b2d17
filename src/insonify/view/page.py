"""The page: a slider over the pings, and layers of what was known and done at each of them."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from insonify.frames import world_from_sonar
from insonify.mission.loop import Step
from insonify.mission.run import Run
from insonify.types import Float64, Ping
from insonify.view import dress, layers, shapes, words
from insonify.view.canvas import Canvas
from insonify.view.server import Server
from insonify.view.story import MapPicture, Story

_REST_S, _STEP_S = 0.05, 0.15
"""Between two drawings, and between two pings when playing."""
_SHARE = 0.1
"""Of the time, for drawing beside something else."""
_IMAGE_WIDTH = 560
_NOTHING: tuple[int, int, int, MapPicture | None] = (-1, -1, -1, None)
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
    """Shows a story in the browser, and follows it while it grows.

    Other web pages that a browser has open cannot read it (`insonify.view.guard`).
    """

    def __init__(
        self,
        story: Story,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        server: Server | None = None,
        beside: bool = False,
    ) -> None:
        """Start serving.

        Args:
            story: What to show.
            host: Address to listen at; 0.0.0.0 is every one.
            port: The first free one from here on.
            server: Instead of a new one at that address.
            beside: Whether the machine is for something else: it then draws while somebody looks
                alone, and for a tenth of the time.

        Raises:
            MissingExtraError: The package viser is not installed.
            OutputError: There is no such address here, or no free port.
        """
        self._server = Server(host, port) if server is None else server
        self._scene = self._server.viser.scene
        self._canvas = Canvas(self._scene)
        self.url = self._server.url
        self._story = story
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._shown = _NOTHING
        self._world_drawn = self._camera_set = False
        self._beside = beside
        self._build()
        self.show(story)
        if beside:
            self._server.viser.on_client_connect(lambda client: self._wake.set())
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._wake.set()
        self._thread.start()

    def show(self, story: Story) -> None:
        """Show another story, or the same with fewer moments."""
        story.changed = self._wake.set
        self._story = story
        self._wake.set()

    def watch(self, run: Run, step: Step) -> None:
        """Show a step of a run that is going on."""
        self._story.watch(run, step)

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._wake.set()
        self._thread.join()
        self._server.close()

    def _build(self) -> None:
        gui = self._server.viser.gui
        layers.light(self._scene)
        self._slider = gui.add_slider("ping", min=0, max=1, step=1, initial_value=0, visible=False)
        self._play = gui.add_checkbox("play", initial_value=False, visible=False)
        self._text = gui.add_html(words.waiting(self._story.title))
        gui.add_html(words.legends())
        self._image = gui.add_html("", visible=False)
        self._boxes, self._nodes = {}, {}
        with gui.add_folder("Layers"):
            for name, (label, shown) in _LAYERS.items():
                node = self._scene.add_frame(f"/{name}", show_axes=False, visible=shown)
                self._nodes[name] = node
                self._boxes[name] = gui.add_checkbox(label, initial_value=shown)
                self._boxes[name].on_update(self._toggled(name))
        self._decision = gui.add_folder("Decision", visible=False)
        with self._decision:
            self._candidates = gui.add_html("")
        self._slider.on_update(lambda event: self._wake.set())
        self._play.on_update(lambda event: self._wake.set())
        for label, key, act in (
            ("previous ping", dress.BACK, lambda event: self._step(-1)),
            ("next ping", dress.ON, lambda event: self._step(1)),
            ("play or pause", "space", lambda event: self._toggle_play()),
        ):
            gui.add_command(label, hotkey=key).on_trigger(act)

    def _toggled(self, name: str) -> Any:
        def toggle(event: object) -> None:
            self._nodes[name].visible = self._boxes[name].value
            self._shown = _NOTHING  # a layer is drawn when it is looked at
            self._wake.set()

        return toggle

    def _step(self, by: int) -> None:
        """Go some pings on, as far as there are any."""
        if self._slider.visible:
            wanted = int(self._slider.value) + by
            self._slider.value = min(max(wanted, self._slider.min), self._slider.max)
            self._wake.set()

    def _toggle_play(self) -> None:
        """Play, from the start if the end is reached; or pause."""
        if self._slider.visible:
            if not self._play.value and self._slider.value == self._slider.max:
                self._slider.value = self._slider.min
            self._play.value = not self._play.value
            self._wake.set()

    def _run(self) -> None:
        """Draw what is asked for last, for as long as the page is open."""
        while not self._closed.is_set():
            woken = self._wake.wait(_STEP_S if self._play.value else None)
            self._wake.clear()
            if self._closed.is_set():
                return
            if not woken:
                self._advance()
            begun_s = time.monotonic()
            with self._server.viser.atomic():
                self._draw(self._story)
            rest_s = _REST_S
            if self._beside:
                rest_s = max(rest_s, (time.monotonic() - begun_s) * (1.0 / _SHARE - 1.0))
            self._closed.wait(rest_s)

    def _advance(self) -> None:
        if self._slider.value < self._slider.max:
            self._slider.value += 1
        else:
            self._play.value = False

    def _draw(self, story: Story) -> None:
        count = len(story.moments)
        self._draw_world(story)
        if self._beside and not self._server.viser.get_clients():
            return
        self._grow(count)
        number = int(self._slider.value) if count else 0
        found = story.maps.at(number)
        told = len(story.decisions) + bool(story.end)
        state = (number, count, told, None if found is None else found[1])
        if state == self._shown:
            return
        self._shown = state
        self._offer_layers(story)
        self._text.content = words.describe(story, number)
        self._draw_map(story, number)
        if number:
            self._draw_ping(story, number)
        self._draw_decision(story, number)

    def _grow(self, count: int) -> None:
        """Let the slider reach the last ping, and stay at the end if it is there."""
        if count == 0 or (self._slider.visible and self._slider.max == count):
            return
        follows = not self._slider.visible or self._slider.value == self._slider.max
        if count < self._slider.max and not follows:  # every other moment was let go
            self._slider.value = (int(self._slider.value) + 1) // 2
        if follows:
            self._slider.value = min(int(self._slider.value), count)
        self._slider.max = max(count, 2)
        self._slider.min = 1
        if follows:
            self._slider.value = count
        self._slider.visible = self._play.visible = count > 1

    def _draw_world(self, story: Story) -> None:
        if story.world and not self._world_drawn:
            self._world_drawn = True
            layers.draw_world(self._scene, story.world)
        if not self._camera_set and (story.region is not None or story.moments):
            self._camera_set = True
            camera = self._server.viser.initial_camera
            camera.position, camera.look_at = shapes.overview(*_extent(story))

    def _offer_layers(self, story: Story) -> None:
        """Boxes for what there is to be seen."""
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

    def _draw_map(self, story: Story, number: int) -> None:
        found = story.maps.at(number)
        if found is None:
            return
        picture = found[1]
        if self._boxes["occupied"].value:
            layers.draw_cubes(self._canvas, "/occupied/cubes", picture.occupied)
        if self._boxes["elsewhere"].value:
            layers.draw_cubes(self._canvas, "/elsewhere/cubes", picture.elsewhere)
        if self._boxes["undecided"].value:
            layers.draw_entropy(self._canvas, picture.undecided)

    def _draw_ping(self, story: Story, number: int) -> None:
        kept = story.images.at(number)
        assert kept is not None
        taken, grey = kept
        geometry = story.moments[taken - 1].geometry
        ping = Ping(grey.astype(np.float32) / 255.0, geometry)
        picture, extent = shapes.fan_picture(ping, _IMAGE_WIDTH)
        of = story.ping_of(taken)
        note = "" if taken == number else f"<br>image of ping {of}, the last one kept"
        self._image.content = words.image(picture, geometry, extent, note)
        self._image.visible = True
        layers.draw_sonar(self._canvas, story.moments[number - 1], picture, extent)
        layers.draw_paths(self._canvas, story.moments[:number])

    def _draw_decision(self, story: Story, number: int) -> None:
        decision = story.decision_at(number)
        if decision is None:
            return
        waypoints = decision.path.waypoints if decision.path is not None else ()
        layers.draw_plan(self._canvas, waypoints)
        layers.draw_decision(self._canvas, decision)
        self._decision.visible = decision.look is not None or decision.stop is not None
        self._candidates.content = words.reasons(decision)


def _extent(story: Story) -> tuple[Float64, Float64]:
    """The corners of what the page shows: the area, or else the space before the sonar."""
    if story.region is not None:
        return np.array(story.region.low_m), np.array(story.region.high_m)
    moment = story.moments[0]
    world = world_from_sonar(moment.pose or layers.AT_ORIGIN, moment.geometry.mount)
    ends = shapes.fan_edges(moment.geometry).reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]
    return ends.min(axis=0), ends.max(axis=0)
