"""A camera in the same world: what people want to see beside a sonar image (OpenGL).

Light loses its energy by exp(-c r), red first, and what the water scatters into the view brings
the image towards the water's own colour: the attenuation and backscatter terms of the usual
underwater image formation model (Jaffe 1990, IEEE J. Oceanic Eng. 15(2) 101-111).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import Field

from insonify.config.settings import Settings
from insonify.frames import transform_from_pose
from insonify.scene import Scene
from insonify.scene.materials import material_colour
from insonify.sonar.gpu import UploadedScene, open_context, projection, set_uniforms, shader
from insonify.types import Pose

Picture = npt.NDArray[np.uint8]

_CONTRAST = 0.02
"""Contrast at the visibility range, by its definition (Koschmieder)."""
_LOSS = (2.6, 1.0, 0.9)
"""Attenuation of red, green and blue over that of green, clear coastal water."""
_HAZE = (0.010, 0.085, 0.115)
"""Colour of open water, linear."""
_DAYLIGHT = (0.55, 0.95, 1.0)
"""And of the light that comes down."""
_SAMPLES = 4


class CameraSettings(Settings):
    """A camera that looks along its pose's forward axis."""

    width_px: int = Field(960, ge=16, le=8192)
    height_px: int = Field(600, ge=16, le=8192)
    fov_deg: float = Field(80.0, gt=1, le=150, description="horizontal field of view")
    visibility_m: float = Field(
        60.0, gt=0, le=10000, description="distance at which contrast has fallen to 2 %"
    )
    daylight: float = Field(1.0, ge=0, le=10, description="light from above")
    lamp: float = Field(1.0, ge=0, le=10, description="light at the camera")


class Camera:
    """Takes pictures of scenes; a scene is uploaded when it is first seen."""

    def __init__(self, settings: CameraSettings = CameraSettings()) -> None:
        """Open OpenGL.

        Raises:
            RendererError: OpenGL 4.3 cannot be had.
        """
        self.settings = settings
        self.context = open_context()
        self._program = self.context.program(
            vertex_shader=shader("camera.vert"), fragment_shader=shader("camera.frag")
        )
        size = (settings.width_px, settings.height_px)
        samples = min(_SAMPLES, self.context.max_samples)
        self._frame = self.context.framebuffer(
            [self.context.renderbuffer(size, 4, samples=samples)],
            self.context.depth_renderbuffer(size, samples=samples),
        )
        self._flat = self.context.simple_framebuffer(size, 4)
        self._uploaded: UploadedScene | None = None
        self._arrays: list[Any] = []

    def take(self, scene: Scene, pose: Pose) -> Picture:
        """A picture (height, width, 3) from a pose, sRGB."""
        if self._uploaded is None or self._uploaded.scene is not scene:
            self._uploaded = UploadedScene(self.context, scene)
            self._arrays = self._uploaded.arrays(self._program)
        uploaded, settings = self._uploaded, self.settings
        eye_from_world = np.linalg.inv(transform_from_pose(pose))
        eye_from_scene = eye_from_world.copy()
        eye_from_scene[:3, 3] += eye_from_world[:3, :3] @ uploaded.middle
        loss_per_m = -math.log(_CONTRAST) / settings.visibility_m
        far_m = 2.5 * settings.visibility_m
        half_width = math.tan(math.radians(settings.fov_deg) / 2)
        half_height = half_width * settings.height_px / settings.width_px
        self._frame.use()
        red, green, blue = (c ** (1 / 2.2) for c in _HAZE)
        self._frame.clear(red, green, blue, 1.0)
        self.context.enable_only(self.context.DEPTH_TEST)
        set_uniforms(
            self._program,
            eye_from_scene=eye_from_scene,
            clip_from_eye=projection(half_width, half_height, min(0.05, 0.01 * far_m), far_m),
            up=tuple(eye_from_world[:3, 2]),
            haze=_HAZE,
            loss_per_m=tuple(loss_per_m * c for c in _LOSS),
            daylight=tuple(settings.daylight * c for c in _DAYLIGHT),
            lamp_power=settings.lamp,
            lamp_m=settings.visibility_m / 6,
            normal_map=2,
        )
        everything = np.zeros((0, 3))
        for body, array in enumerate(self._arrays):
            near = uploaded.in_reach(body, eye_from_scene, everything, far_m)
            texture = uploaded.bodies[body].texture
            colour = material_colour(scene.materials[body].name)
            set_uniforms(self._program, colour=colour, bumpy=texture is not None)
            if texture is not None:
                texture.use(2)
            uploaded.draw(array, body, near)
        self.context.copy_framebuffer(self._flat, self._frame)
        raw = np.frombuffer(self._flat.read(components=3, alignment=1), np.uint8)
        return np.ascontiguousarray(raw.reshape(settings.height_px, settings.width_px, 3)[::-1])
