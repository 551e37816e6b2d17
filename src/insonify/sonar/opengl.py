"""The OpenGL renderer: the GLSL chain of Cerqueira et al. 2017, section 3.

A fan is drawn by cameras side by side, none wider than 40 degrees, so that resolution stays even
up to 360 degrees.  Their pixels are binned on the device; only beams x bins come back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from insonify.errors import RendererError
from insonify.frames import directions_from_angles, rotation_from_rpy, world_from_sonar
from insonify.scene import Scene
from insonify.sonar.draws import CELLS, normal_table, skew_normal_table
from insonify.sonar.formation import ImageSettings
from insonify.sonar.gpu import UploadedScene, open_context, projection, set_uniforms, shader
from insonify.sonar.histogram import (
    BEYOND,
    FULL_CELL,
    LEAST_FACING,
    EchoHistogram,
    Response,
    Samples,
    side_by_side,
)
from insonify.sonar.sampling import SamplingSettings, even_samples
from insonify.types import Array, FanGeometry, Float32, Float64, Pose

_WIDEST_RAD = math.radians(40.0)
_NEAREST_M = 0.05
_UNIT = float(2**30)


class OpenGLRenderer:
    """Renders echo histograms with OpenGL; `sonar.histogram.Renderer`.

    A scene is uploaded when it is first seen and kept until another comes.
    """

    def __init__(self, sampling: SamplingSettings = SamplingSettings()) -> None:
        """Open OpenGL.

        Raises:
            RendererError: OpenGL 4.3 cannot be had.
        """
        self.sampling = sampling
        self.context = open_context()
        self._draw = self.context.program(
            vertex_shader=shader("sonar.vert"), fragment_shader=shader("sonar.frag")
        )
        self._bin = self.context.compute_shader(shader("bin.comp"))
        self._uploaded: UploadedScene | None = None
        self._arrays: list[Any] = []
        self._targets: dict[tuple[int, int], _Target] = {}
        self._form = self.context.compute_shader(shader("form.comp"))
        self._sums: dict[tuple[int, int], tuple[Any, Any, Any]] = {}
        self._tables: tuple[tuple[float, float], Any] | None = None

    @property
    def device(self) -> str:
        """What draws."""
        return str(self.context.info["GL_RENDERER"])

    def render(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> EchoHistogram:
        """The echoes of a scene from a vehicle pose."""
        shape = (geometry.beams, geometry.bins)
        echo, coverage = (
            np.frombuffer(buffer.read(), np.uint32).reshape(shape) / np.float32(_UNIT)
            for buffer in self._bin_fan(scene, geometry, pose, response)[:2]
        )
        return EchoHistogram(echo.T.astype(np.float32), coverage.T.astype(np.float32))

    def image(
        self,
        scene: Scene,
        geometry: FanGeometry,
        pose: Pose,
        response: Response,
        settings: ImageSettings,
        key: int,
    ) -> Float32:
        """`sonar.formation.form_image` of `render`, to rounding; nothing else leaves the device."""
        *_, formed = self._bin_fan(scene, geometry, pose, response)
        self._tables_of(settings).bind_to_storage_buffer(2)
        formed.bind_to_storage_buffer(3)
        beams, bins = geometry.beams, geometry.bins
        set_uniforms(
            self._form,
            beams=beams,
            bins=bins,
            cells=CELLS,
            key_low=key & 0xFFFFFFFF,
            key_high=key >> 32,
            unit=_UNIT,
            least=FULL_CELL / bins,
            noise=settings.noise,
        )
        pairs = -(-bins // 2)
        self._form.run(-(-pairs // 16), -(-beams // 16))
        self.context.memory_barrier()
        return np.frombuffer(formed.read(), np.float32).reshape(beams, bins).T

    def _tables_of(self, settings: ImageSettings) -> Any:
        """Speckle's and noise's quantiles on the device."""
        wanted = (settings.speckle, settings.speckle_skew)
        if self._tables is None or self._tables[0] != wanted:
            both = np.stack([skew_normal_table(*wanted), normal_table()])
            self._tables = wanted, self.context.buffer(both.tobytes())
        return self._tables[1]

    def _bin_fan(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> tuple[Any, Any, Any]:
        """Draw and bin a fan: sums of echo and coverage, and room for the image."""
        target = self._draw_fan(scene, geometry, pose, response)
        shape = (geometry.beams, geometry.bins)
        if shape not in self._sums:
            size = 4 * geometry.beams * geometry.bins
            echo, coverage, formed = (self.context.buffer(reserve=size) for _ in range(3))
            self._sums[shape] = echo, coverage, formed
        sums = self._sums[shape]
        for slot, buffer in enumerate(sums[:2]):
            buffer.clear()
            buffer.bind_to_storage_buffer(slot)
        target.channels.use(0)
        target.patches.use(1)
        set_uniforms(
            self._bin,
            beams=geometry.beams,
            bins=geometry.bins,
            half_azimuth=geometry.azimuth_fov_rad / 2,
            beam_rad=geometry.beam_rad,
            range_min_m=geometry.range_min_m,
            bin_m=geometry.bin_m,
            unit=_UNIT,
        )
        width, height = target.channels.size
        self._bin.run(-(-width // 16), -(-height // 16))
        self.context.memory_barrier()
        return sums

    def render_all(
        self, scene: Scene, fans: Sequence[FanGeometry], poses: Sequence[Pose], response: Response
    ) -> EchoHistogram:
        """The echoes of several pings, drawn one after another."""
        pairs = zip(fans, poses, strict=True)
        return side_by_side([self.render(scene, fan, pose, response) for fan, pose in pairs])

    def sample(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> list[Samples]:
        """The pixels that echo, beam after beam."""
        target = self._draw_fan(scene, geometry, pose, response)
        channels, patches = (
            np.frombuffer(texture.read(), np.float32).reshape(-1, 4)
            for texture in (target.channels, target.patches)
        )
        hit = channels[:, 3] > 0.0
        channels, patches = channels[hit], patches[hit]
        beam = (geometry.azimuth_fov_rad / 2 - channels[:, 2]) / geometry.beam_rad
        beam = np.clip(beam.astype(int), 0, geometry.beams - 1)
        order = np.argsort(beam, kind="stable")
        channels, patches = channels[order], patches[order]
        directions = directions_from_angles(
            channels[:, 2].astype(np.float64), patches[:, 3].astype(np.float64)
        )
        return [
            Samples(
                offsets=np.searchsorted(beam[order], np.arange(geometry.beams + 1)),
                direction=directions.astype(np.float32),
                range_m=channels[:, 1].copy(),
                rise_m=patches[:, 0].copy(),
                skew_m=patches[:, 1].copy(),
                echo=channels[:, 0].copy(),
                weight=channels[:, 3].copy(),
                body=patches[:, 2].astype(np.int32),
            )
        ]

    def _draw_fan(
        self, scene: Scene, geometry: FanGeometry, pose: Pose, response: Response
    ) -> _Target:
        """Draw all cameras of a fan."""
        if response.indirect:
            raise RendererError(
                "second_bounce, surface_mirror and surface_db need rays: render with Embree "
                "(--renderer embree), or leave them out"
            )
        uploaded = self._upload(scene)
        cameras = _cameras(geometry, *even_samples(geometry, self.sampling))
        target = self._target(sum(c.columns for c in cameras), cameras[0].rows)
        sonar_from_world = np.linalg.inv(world_from_sonar(pose, geometry.mount))
        sonar_from_scene = sonar_from_world.copy()
        sonar_from_scene[:3, 3] += sonar_from_world[:3, :3] @ uploaded.middle
        limit_m = BEYOND * geometry.range_max_m
        target.frame.use()
        self.context.viewport = (0, 0, *target.channels.size)
        target.frame.clear(0.0, 0.0, 0.0, 0.0)
        self.context.enable_only(self.context.DEPTH_TEST)
        set_uniforms(
            self._draw,
            sonar_from_scene=sonar_from_scene,
            half_fov=(geometry.azimuth_fov_rad / 2, geometry.elevation_fov_rad / 2),
            beam_rad=geometry.beam_rad,
            limit_m=limit_m,
            least_facing=LEAST_FACING,
            response=tuple(response.vector(geometry)),
            normal_map=2,
        )
        strengths = response.strengths(scene)
        left = 0
        for camera in cameras:
            self.context.viewport = (left, 0, camera.columns, camera.rows)
            left += camera.columns
            set_uniforms(
                self._draw,
                clip_from_sonar=camera.clip_from_sonar(limit_m),
                camera_azimuth=camera.azimuth_rad,
                pixel=camera.pixel,
            )
            self._draw_bodies(uploaded, strengths, sonar_from_scene, camera, limit_m)
        return target

    def _draw_bodies(
        self,
        uploaded: UploadedScene,
        strengths: Float32,
        sonar_from_scene: Array,
        camera: _Camera,
        limit_m: float,
    ) -> None:
        """Draw what a camera may see."""
        for body, array in enumerate(self._arrays):
            seen = uploaded.in_reach(body, sonar_from_scene, camera.planes, limit_m)
            if not seen.any():
                continue
            texture = uploaded.bodies[body].texture
            set_uniforms(
                self._draw,
                strength=float(strengths[body]),
                body=float(body),
                bumpy=texture is not None,
            )
            if texture is not None:
                texture.use(2)
            uploaded.draw(array, body, seen)

    def _upload(self, scene: Scene) -> UploadedScene:
        if self._uploaded is None or self._uploaded.scene is not scene:
            self._uploaded = UploadedScene(self.context, scene)
            self._arrays = self._uploaded.arrays(self._draw)
        return self._uploaded

    def _target(self, width: int, height: int) -> _Target:
        if (width, height) not in self._targets:
            channels = self.context.texture((width, height), 4, dtype="f4")
            patches = self.context.texture((width, height), 4, dtype="f4")
            depth = self.context.depth_renderbuffer((width, height))
            frame = self.context.framebuffer([channels, patches], depth)
            self._targets[width, height] = _Target(frame, channels, patches)
        return self._targets[width, height]


@dataclass(frozen=True, slots=True, eq=False)
class _Target:
    """Where a fan is drawn: the paper's channels, and what each pixel stands for."""

    frame: Any
    channels: Any
    patches: Any


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """A perspective camera that covers a part of a fan.

    Attributes:
        azimuth_rad: Where it looks.
        half_width: Tangent of half its horizontal field of view.
        half_height: The same upwards, enough for the elevation at its sides.
        columns: Pixels across.
        rows: Pixels over.
    """

    azimuth_rad: float
    half_width: float
    half_height: float
    columns: int
    rows: int

    @property
    def pixel(self) -> tuple[float, float]:
        """Width and height of a pixel at unit distance."""
        return (2 * self.half_width / self.columns, 2 * self.half_height / self.rows)

    @property
    def planes(self) -> Float64:
        """Inward normals (4, 3) of its sides, sonar frame."""
        sides = np.array(
            [
                [self.half_width, 1.0, 0.0],
                [self.half_width, -1.0, 0.0],
                [self.half_height, 0.0, 1.0],
                [self.half_height, 0.0, -1.0],
            ]
        )
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        turned: Float64 = sides @ rotation_from_rpy(0.0, 0.0, self.azimuth_rad).T
        return turned

    def clip_from_sonar(self, far_m: float) -> Float64:
        """Projection, (4, 4): port is left, depth from ``_NEAREST_M`` to ``far_m``."""
        near_m = min(_NEAREST_M, 0.5 * far_m)
        project = projection(self.half_width, self.half_height, near_m, far_m)
        turn = np.eye(4)
        turn[:3, :3] = rotation_from_rpy(0.0, 0.0, -self.azimuth_rad)
        return project @ turn


@lru_cache(maxsize=8)
def _cameras(geometry: FanGeometry, across: int, over: int) -> tuple[_Camera, ...]:
    """Cameras side by side from port to starboard.

    A camera cannot put pixels at edges only, as rays can be, so there are more of them: with twice
    the even samples each way, and four across a beam, images err by 3 % of full scale, with these
    by 2 %.
    """
    count = math.ceil(geometry.azimuth_fov_rad / _WIDEST_RAD)
    span = geometry.azimuth_fov_rad / count
    columns = math.ceil(max(6, 3 * across) * geometry.beams / count)
    half_height = math.tan(geometry.elevation_fov_rad / 2) / math.cos(span / 2)
    return tuple(
        _Camera(
            geometry.azimuth_fov_rad / 2 - (k + 0.5) * span,
            math.tan(span / 2),
            half_height,
            columns,
            math.ceil(3.5 * over),
        )
        for k in range(count)
    )
