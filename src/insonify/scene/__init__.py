"""3D worlds: bodies on a seabed, and what rays meet in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from insonify.errors import MeshError
from insonify.frames import directions_from_angles
from insonify.limits import FARTHEST_M
from insonify.scene.materials import Material, NormalMap, bend_normals
from insonify.scene.rays import Hits, RayTracer
from insonify.scene.seabed import Seabed
from insonify.types import Box, Float32, Float64, Pose, ScanPath

__all__ = ["Body", "Material", "Scene"]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A mesh in its place, metres, world frame; its name is its label in ground truth.

    Raises:
        MeshError: It lies farther away than `insonify.limits.FARTHEST_M`, or nowhere.
    """

    name: str
    mesh: trimesh.Trimesh
    material: Material = Material("default")
    normal_map: NormalMap | None = None

    def __post_init__(self) -> None:
        vertices = np.asarray(self.mesh.vertices)
        if not (np.abs(vertices) <= FARTHEST_M).all():
            raise MeshError(
                f"{self.name!r:.80}: in its place it is not within {FARTHEST_M:g} m of the origin; "
                "check its size and its poses"
            )

    @property
    def box(self) -> Box:
        """The axis-aligned bounding box."""
        return Box.of(*self.mesh.bounds)


class Scene:
    """Bodies and, optionally, a seabed.  Geometry does not change once it is built."""

    def __init__(
        self,
        bodies: tuple[Body, ...] = (),
        seabed: Seabed | None = None,
        seabed_material: Material = Material("sand", 1.0),
    ) -> None:
        """Build from bodies; the seabed, if any, is the last body of every ray query."""
        self.bodies = bodies
        self.seabed = seabed
        self._reliefs: dict[int, tuple[Float32, Float32, Float32]] = {}
        materials = [body.material for body in bodies]
        self.meshes = [
            (np.asarray(body.mesh.vertices), np.asarray(body.mesh.faces)) for body in bodies
        ]
        if seabed is not None:
            self.meshes.append(seabed.triangles())
            materials.append(seabed_material)
        if not self.meshes:
            raise ValueError("a scene needs a body or a seabed")
        self.materials = tuple(materials)
        self.labels = tuple(body.name for body in bodies) + (("seabed",) if seabed else ())
        self.reflectance: Float32 = np.array([m.reflectance for m in materials], np.float32)
        self.lambert: Float32 = np.array([10 ** (m.lambert_db / 10) for m in materials], np.float32)

    @cached_property
    def rays(self) -> RayTracer:
        """The ray tracer over all bodies and the seabed."""
        return RayTracer(self.meshes)

    def cast(self, origin_m: Float64, directions: Float32, limit_m: float = np.inf) -> Hits:
        """First hits of rays; see `RayTracer.cast`."""
        return self.rays.cast(origin_m, directions, limit_m)

    def shading_normals(self, hits: Hits, directions: Float32) -> Float32:
        """Normals (N, 3) that the echo depends on: the triangles', or those of normal maps."""
        bumpy = [k for k, body in enumerate(self.bodies) if body.normal_map is not None]
        if not bumpy:
            return hits.normal
        normal = hits.normal.copy()
        for body in bumpy:
            mask = np.flatnonzero(hits.body == body).astype(np.int32)
            if len(mask):
                bend_normals(normal, directions, mask, hits.triangle, hits.uv, *self._relief(body))
        return normal

    def _relief(self, body: int) -> tuple[Float32, Float32, Float32]:
        """Corners, texture coordinates and normals of a body's normal map, as kernels take them."""
        if body not in self._reliefs:
            mesh, relief = self.bodies[body].mesh, self.bodies[body].normal_map
            assert relief is not None
            faces = np.asarray(mesh.faces)
            corners = np.asarray(mesh.vertices - mesh.vertices.mean(axis=0), np.float32)[faces]
            self._reliefs[body] = corners, relief.uv.astype(np.float32)[faces], relief.normals
        return self._reliefs[body]

    def first_collision(self, path: ScanPath, clearance_m: float) -> Pose | None:
        """The first pose on a path that comes nearer than ``clearance_m`` to anything, or None.

        Each leg is sampled every half clearance; at each sample the surroundings are probed in
        directions spread evenly over the sphere, and a point below the seabed or inside a closed
        body is a collision whatever its clearance.
        """
        for pose in _samples(path, clearance_m / 2):
            position = np.array(pose.position_m)
            hits = self.cast(position, _SPHERE)
            if float(hits.range_m.min()) < clearance_m or self._encloses(pose):
                return pose
        return None

    def _encloses(self, pose: Pose) -> bool:
        x, y, z = (np.atleast_1d(c) for c in pose.position_m)
        if self.seabed is not None and z[0] <= self.seabed.height_at(x, y)[0]:
            return True
        for body in self.bodies:
            low, high = body.mesh.bounds
            inside_box = bool(np.all((low < pose.position_m) & (pose.position_m < high)))
            if inside_box and body.mesh.is_watertight:
                return bool(body.mesh.contains(np.array([pose.position_m]))[0])
        return False


def _samples(path: ScanPath, step_m: float) -> list[Pose]:
    """Positions along a path, at most ``step_m`` apart, with both ends."""
    samples = [path.waypoints[0]]
    for start, end in zip(path.waypoints, path.waypoints[1:], strict=False):
        gap = np.subtract(end.position_m, start.position_m)
        count = max(1, int(np.ceil(np.linalg.norm(gap) / step_m)))
        for k in range(1, count + 1):
            x, y, z = np.add(start.position_m, gap * (k / count))
            samples.append(Pose(float(x), float(y), float(z), yaw_rad=end.yaw_rad))
    return samples


def _fibonacci_sphere(count: int) -> Float32:
    """Nearly even unit directions, (count, 3)."""
    k = np.arange(count)
    azimuth = k * (np.pi * (3.0 - np.sqrt(5.0)))
    elevation = np.arcsin(1.0 - 2.0 * (k + 0.5) / count)
    return directions_from_angles(azimuth, elevation).astype(np.float32)


_SPHERE = _fibonacci_sphere(128)
