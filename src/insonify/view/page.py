"""The page: a slider over the pings, and layers of what was known and done at each of them."""

from __future__ import annotations

import atexit
import base64
import contextlib
import errno
import html
import io
import math
import socket
import threading
import time
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from insonify.errors import OutputError
from insonify.frames import quaternion_from_rotation, transform_from_pose, world_from_sonar
from insonify.io.extras import optional
from insonify.mission import Step
from insonify.planning.decision import Decision
from insonify.report.pictures import scan_colour
from insonify.runs import Run
from insonify.types import Array, FanGeometry, Float32, Float64, Ping, Pose
from insonify.view import shapes
from insonify.view.cubes import Cubes
from insonify.view.story import MapPicture, Moment, Story

_REST_S, _STEP_S = 0.05, 0.15
"""Between two drawings, and between two pings when playing."""
_PORTS_TRIED = 100
_NOTHING = (-1, -1, -1)
_AT_ORIGIN = Pose(0.0, 0.0, 0.0)
_PLANNED, _TRUE_PATH, _CLUSTER = (150, 150, 150), (240, 240, 240), (76, 201, 240)
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
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
    """A web server that shows a story, and follows it while it grows."""

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
        with contextlib.redirect_stdout(io.StringIO()):  # where it announces itself
            self._server = viser.ViserServer(host=host, port=port, label="insonify", verbose=False)
        atexit.unregister(self._server.stop)  # which says so on stdout
        self.url = f"http://{host}:{self._server.get_port()}"
        self._story = story
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._shown = _NOTHING
        self._fan: FanGeometry | None = None
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
                shapes.colour_bar("viridis", "0.5", "1", "probability of an occupied voxel")
                + shapes.colour_bar("magma", "0.5", "1", "entropy of an undecided voxel, bits")
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
        found = story.maps.at(number)
        if found is not None:
            self._draw_map(found[1])
        if number:
            self._draw_moment(number)
        decision = story.decision_at(number)
        if decision is not None:
            self._draw_decision(decision, last=number == count)
        self._text.content = self._describe(number, count, None if found is None else found[0])

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
            for solid in story.world:
                seabed = solid.name == "seabed"
                self._server.scene.add_mesh_simple(
                    f"/{'seabed' if seabed else 'object'}/{solid.name}",
                    np.asarray(solid.vertices, np.float32),
                    np.asarray(solid.faces, np.uint32),
                    color=(94, 84, 64) if seabed else (230, 230, 235),
                    opacity=None if seabed else 0.55,
                    flat_shading=True,
                    side="double",
                    cast_shadow=False,
                    receive_shadow=False,
                )
        if not story.world:
            self._boxes["object"].visible = self._boxes["seabed"].visible = False
        else:
            self._boxes["object"].visible = self._boxes["seabed"].visible = True
        if story.region is not None and not self._camera_set:
            self._camera_set = True
            low, high = np.array(story.region.low_m), np.array(story.region.high_m)
            camera = self._server.initial_camera
            camera.position, camera.look_at = shapes.overview(low, high)

    def _draw_map(self, picture: MapPicture) -> None:
        for name, cubes in (("occupied", picture.occupied), ("elsewhere", picture.elsewhere)):
            if self._boxes[name].value:
                self._draw_cubes(f"/{name}/cubes", cubes)
        if self._boxes["undecided"].value:
            undecided = picture.undecided
            self._server.scene.add_point_cloud(
                "/undecided/points",
                undecided.centres_m,
                _rgb("magma", 2.0 * undecided.value - 1.0),
                point_size=0.4 * undecided.edge_m,
                precision="float32",
            )

    def _draw_cubes(self, name: str, cubes: Cubes) -> None:
        if not len(cubes.index):
            self._server.scene.remove_by_name(name)
            return
        self._server.scene.add_batched_meshes_simple(
            name,
            shapes.CUBE_CORNERS * np.float32(cubes.edge_m),
            shapes.CUBE_FACES,
            batched_wxyzs=np.tile(_UPRIGHT, (len(cubes.index), 1)),
            batched_positions=cubes.centres_m,
            batched_colors=_rgb("viridis", 2.0 * cubes.value - 1.0),
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
            lod="off",
        )

    def _draw_moment(self, number: int) -> None:
        story = self._story
        moment = story.moments[number - 1]
        kept = story.images.at(number)
        assert kept is not None
        geometry = story.moments[kept[0] - 1].geometry
        ping = Ping(kept[1].astype(np.float32) / 255.0, geometry)
        picture, extent = shapes.fan_picture(ping, 560)
        data = base64.b64encode(shapes.png_bytes(picture)).decode()
        note = "" if kept[0] == number else f"<br>image of ping {kept[0]}, the last one kept"
        self._image.content = (
            f'<img alt="sonar image" src="data:image/png;base64,{data}" '
            f'style="width:100%;max-height:45vh;object-fit:contain;background:#000">{note}'
        )
        self._image.visible = True
        self._draw_sonar(moment, picture, extent)
        self._draw_paths(number)

    def _draw_sonar(
        self, moment: Moment, picture: Array, extent: tuple[float, float, float, float]
    ) -> None:
        scene = self._server.scene
        geometry = moment.geometry
        world = world_from_sonar(moment.pose or _AT_ORIGIN, geometry.mount)
        _place(scene, "/sonar/frame", world)
        if geometry != self._fan:
            self._fan = geometry
            scene.add_line_segments(
                "/sonar/frame/edges", shapes.fan_edges(geometry), (255, 190, 90),
                thickness=1.5, thickness_units="screen",
            )  # fmt: skip
        left, right, near, far = extent
        scene.add_image(
            "/sonar/frame/image",
            picture[::-2, ::2],  # its first row lies at the bottom there
            render_width=right - left,
            render_height=far - near,
            format="png",
            wxyz=_IMAGE_WXYZ,
            position=((near + far) / 2, 0.0, 0.0),
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_paths(self, number: int) -> None:
        scene = self._server.scene
        flown = self._story.moments[:number]
        posed = [moment for moment in flown if moment.pose is not None]
        lines, colours = [], []
        for a, b in pairwise(posed):
            assert a.pose is not None and b.pose is not None
            lines.append((a.pose.position_m, b.pose.position_m))
            same = a.scan == b.scan
            colours.append(_scan_rgb(b.scan) if same else _PLANNED)
        _lines(scene, "/path/flown", np.array(lines, np.float32), np.array(colours, np.uint8), 3.0)
        true = [moment.true_pose or moment.pose or _AT_ORIGIN for moment in flown]
        differs = any(moment.true_pose is not None for moment in flown)
        segments = shapes.path_segments(true) if differs else np.zeros((0, 2, 3), np.float32)
        _lines(scene, "/path/true", segments, _TRUE_PATH, 1.5)

    def _draw_decision(self, decision: Decision, last: bool) -> None:
        scene = self._server.scene
        poses = decision.path.waypoints if decision.path is not None else ()
        _lines(scene, "/path/planned", shapes.path_segments(poses), _PLANNED, 1.0)
        look = decision.look
        for name in ("/candidates/all", "/cluster/all"):
            scene.remove_by_name(name)
        self._decision.visible = look is not None or (last and bool(self._story.end))
        rows = ""
        if look is not None:
            share = look.h_cluster / look.cluster.entropy
            scene.add_frame("/candidates/all", show_axes=False)
            _lines(
                scene, "/candidates/all/yaws", shapes.pointers(look.candidates, 1.0),
                _rgb("viridis", share / max(float(share.max()), 1e-9)), 3.0,
            )  # fmt: skip
            for k, pose in enumerate(look.candidates):
                best = " \N{BLACK STAR}" if k == look.best else ""
                scene.add_label(
                    f"/candidates/all/{k}", f"{k}: {share[k]:.0%}{best}", position=pose.position_m,
                    font_screen_scale=0.8,
                )  # fmt: skip
                rows += (
                    f"<tr><td>{k}{best}</td><td>{look.h_sum[k]:.0f}</td>"
                    f"<td>{look.h_cluster[k]:.0f}</td><td>{share[k]:.1%}</td></tr>"
                )
            scene.add_point_cloud(
                "/cluster/all", look.cluster.voxels_m.astype(np.float32), _CLUSTER,
                point_size=0.05, precision="float32",
            )  # fmt: skip
        self._candidates.content = self._reasons(decision, rows)

    def _reasons(self, decision: Decision, rows: str) -> str:
        text = '<div style="font-size:0.85em;padding:0 1em 0.5em">'
        if decision.look is not None:
            cluster = decision.look.cluster
            text += (
                f"Largest cluster: {len(cluster.voxels_m):,} undecided voxels, "
                f"{cluster.entropy:,.0f} bits. What each candidate would see:"
                '<table style="width:100%"><tr><th>candidate</th><th>H, bits</th>'
                f"<th>of cluster</th><th>share</th></tr>{rows}</table>"
            )
        if decision.stop is not None:
            text += html.escape(decision.stop.value)
        return text + "</div>"

    def _describe(self, number: int, count: int, mapped: int | None) -> str:
        lines = [f"<b>{html.escape(self._story.title)}</b>"]
        if number:
            moment = self._story.moments[number - 1]
            when = f", {moment.time_s:.2f} s" if moment.time_s else ""
            lines.append(f"ping {number} of {count}, scan {moment.scan}{when}")
            lines.append(_whereabouts(moment))
        found = self._story.maps.at(number)
        if found is not None:
            picture = found[1]
            after = "" if mapped in (number, 0) else f" after ping {mapped}"
            lines.append(f"{picture.occupied.count:,} voxels occupied in the area{after}")
            if picture.occupied.times > 1:
                lines.append(f"merged into cubes of {picture.occupied.edge_m:g} m")
        if self._story.end and number == count:
            lines.append(html.escape(self._story.end))
        return '<div style="padding:0 1em;font-size:0.9em">' + "<br>".join(lines) + "</div>"


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


def _whereabouts(moment: Moment) -> str:
    if moment.pose is None:
        return "no pose: drawn at the origin"
    x, y, z = moment.pose.position_m
    text = f"at ({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {math.degrees(moment.pose.yaw_rad):.1f}°"
    if moment.true_pose is not None:
        off = math.dist(moment.pose.position_m, moment.true_pose.position_m)
        text += f"<br>{off:.2f} m from where it really was"
    return text


def _place(scene: Any, name: str, transform: Float64) -> None:
    scene.add_frame(
        name, wxyz=_wxyz(transform[:3, :3]), position=transform[:3, 3], axes_length=0.6,
        axes_radius=0.02,
    )  # fmt: skip


def _wxyz(rotation: Float64) -> Float64:
    x, y, z, w = quaternion_from_rotation(rotation)
    return np.array([w, x, y, z])


_IMAGE_WXYZ = _wxyz(transform_from_pose(Pose(0, 0, 0, 0.0, 0.0, -math.pi / 2))[:3, :3])
"""A picture's right is the sonar's starboard and its top ahead."""


def _lines(
    scene: Any, name: str, segments: Float32, colours: Array | tuple[int, int, int], width: float
) -> None:
    """Line segments (N, 2, 3) in one colour, or one (N, 3) for each."""
    if not len(segments):
        scene.remove_by_name(name)
        return
    if not isinstance(colours, tuple):
        colours = np.repeat(colours[:, None, :], 2, axis=1)
    scene.add_line_segments(name, segments, colours, thickness=width, thickness_units="screen")


def _rgb(name: str, share: Float32 | Float64) -> Array:
    """Colours (N, 3) bytes of a matplotlib colour map."""
    colours: Array = colormaps[name](np.clip(share, 0.0, 1.0), bytes=True)[:, :3]
    return np.ascontiguousarray(colours)


def _scan_rgb(number: int) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in to_rgb(scan_colour(number)))
    return red, green, blue
