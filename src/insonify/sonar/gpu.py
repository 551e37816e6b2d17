"""OpenGL without a window: the context, and scenes uploaded to the device.

A scene is uploaded once.  Its triangles are sorted along a space-filling curve and cut into
chunks, so that only chunks near the fan are drawn.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from insonify.errors import RendererError
from insonify.scene import Scene
from insonify.types import Array, Bool, Float32, Float64, Int32

if TYPE_CHECKING:
    import moderngl

_TRIANGLES_A_CHUNK = 256
_EMBREE = "or render with Embree (--renderer embree)"


@cache
def open_context() -> moderngl.Context:
    """The process's OpenGL context, without a window.

    Raises:
        RendererError: ``moderngl`` is not installed, there is no EGL, or OpenGL is older than 4.3.
    """
    try:
        import moderngl
    except ImportError as err:
        raise RendererError(
            f"the OpenGL renderer needs moderngl: pip install 'insonify[opengl]', {_EMBREE}"
        ) from err
    backend: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        context = moderngl.create_context(standalone=True, **backend)
    except Exception as err:  # each platform's loader raises errors of its own
        raise RendererError(
            f"there is no OpenGL without a window here ({_first_line(err)}); install EGL, for "
            f"Mesa's on Debian: apt install libegl1 libgl1-mesa-dri, {_EMBREE}"
        ) from err
    if context.version_code < 430:
        version = context.info["GL_VERSION"]
        context.release()
        raise RendererError(
            f"the OpenGL renderer needs OpenGL 4.3 and here is {version}; update the driver, "
            f"{_EMBREE}"
        )
    return context


def _first_line(err: Exception) -> str:
    lines = str(err).strip().splitlines()
    return lines[0] if lines else type(err).__name__


def shader(name: str) -> str:
    """The text of a shader of ours."""
    return resources.files("insonify.sonar").joinpath("shaders", name).read_text(encoding="utf-8")


def set_uniforms(program: Any, **uniforms: Any) -> None:
    """Set uniforms; a matrix goes by columns.  One that the compiler dropped is left out."""
    for name, value in uniforms.items():
        if name not in program:
            continue
        if isinstance(value, np.ndarray):
            program[name].write(np.ascontiguousarray(value.T, "f4").tobytes())
        else:
            program[name].value = value


def projection(half_width: float, half_height: float, near_m: float, far_m: float) -> Float64:
    """Clip space from the space of an eye that looks along x, with y to the left, z up, (4, 4).

    Args:
        half_width: Tangent of half the horizontal field of view.
        half_height: Of half the vertical one.
        near_m: Nothing nearer is drawn.
        far_m: Nor farther.
    """
    project = np.zeros((4, 4))
    project[0, 1] = -1.0 / half_width
    project[1, 2] = 1.0 / half_height
    project[2, 0] = (far_m + near_m) / (far_m - near_m)
    project[2, 3] = -2.0 * far_m * near_m / (far_m - near_m)
    project[3, 0] = 1.0
    return project


@dataclass(frozen=True, slots=True, eq=False)
class _Uploaded:
    """One body on the device: its buffers, its chunks' boxes, its normal map."""

    vertices: Any
    indices: Any
    low: Float32
    high: Float32
    triangles: int
    texture: Any


class UploadedScene:
    """A scene's triangles on the device, metres from ``middle``."""

    def __init__(self, context: moderngl.Context, scene: Scene) -> None:
        """Upload all bodies."""
        self.context = context
        self.scene = scene
        corners = np.array([[v.min(axis=0), v.max(axis=0)] for v, _ in scene.meshes])
        self.middle = (corners[:, 0].min(axis=0) + corners[:, 1].max(axis=0)) / 2
        self.bodies = [self._upload(k) for k in range(len(scene.meshes))]

    def _upload(self, body: int) -> _Uploaded:
        vertices, faces = self.scene.meshes[body]
        local = np.ascontiguousarray(vertices - self.middle, np.float32)
        order = _along_a_curve(local[faces].mean(axis=1))
        faces = np.ascontiguousarray(faces[order], np.int32)
        relief = self.scene.bodies[body].normal_map if body < len(self.scene.bodies) else None
        uv = np.zeros((len(local), 2), np.float32)
        texture = None
        if relief is not None:
            uv[:] = relief.uv
            height, width = relief.normals.shape[:2]
            texture = self.context.texture(
                (width, height), 3, np.ascontiguousarray(relief.normals, "f4").tobytes(), dtype="f4"
            )
        packed = np.ascontiguousarray(np.hstack([local, uv]), np.float32)
        low, high = _chunk_boxes(local, faces)
        return _Uploaded(
            self.context.buffer(packed.tobytes()),
            self.context.buffer(faces.tobytes()),
            low,
            high,
            len(faces),
            texture,
        )

    def arrays(self, program: moderngl.Program) -> list[Any]:
        """A vertex array for each body; attributes that the program lacks are left out."""
        made = []
        for body in self.bodies:
            takes_uv = "texture_uv" in program
            layout = ("3f 2f", "position", "texture_uv") if takes_uv else ("3f 2x4", "position")
            made.append(
                self.context.vertex_array(program, [(body.vertices, *layout)], body.indices)
            )
        return made

    def draw(self, array: Any, body: int, visible: Bool) -> None:
        """Draw the visible chunks of a body, neighbours in one call."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], visible, [False]]).astype(int)))
        total = self.bodies[body].triangles
        for start, stop in edges.reshape(-1, 2) * _TRIANGLES_A_CHUNK:
            last = min(int(stop), total)
            array.render(first=3 * int(start), vertices=3 * (last - int(start)))

    def in_reach(self, body: int, eye_from_scene: Array, planes: Float64, far_m: float) -> Bool:
        """Chunks of a body that planes through the eye and a sphere around it do not rule out.

        Args:
            body: Which.
            eye_from_scene: (4, 4).
            planes: (P, 3) inward normals, in the eye's frame.
            far_m: The sphere's radius.
        """
        low, high = self.bodies[body].low, self.bodies[body].high
        half = (high - low) / 2
        turn, shift = eye_from_scene[:3, :3], eye_from_scene[:3, 3]
        centre = (low + half) @ turn.T + shift
        visible = np.linalg.norm(centre, axis=1) - np.linalg.norm(half, axis=1) <= far_m
        for normal in planes:
            reach = half @ np.abs(turn.T @ normal)
            visible &= centre @ normal + reach >= 0.0
        return np.asarray(visible, np.bool_)


def _chunk_boxes(local: Float32, faces: Int32) -> tuple[Float32, Float32]:
    """The bounding boxes (chunks, 3) of runs of triangles."""
    starts = np.arange(0, len(faces), _TRIANGLES_A_CHUNK)
    corners = local[faces]
    low = np.minimum.reduceat(corners.min(axis=1), starts, axis=0)
    high = np.maximum.reduceat(corners.max(axis=1), starts, axis=0)
    return low, high


def _along_a_curve(points: Float32) -> Array:
    """Order of points (N, 3) along a Morton curve: neighbours in the list are near in space."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, np.float32(1e-9))
    cells = np.clip((points - low) / span * 1023.0, 0, 1023).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            shift = np.uint64(3 * bit + axis)
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << shift
    return np.argsort(code, kind="stable")
