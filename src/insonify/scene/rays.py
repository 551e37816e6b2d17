"""Ray queries through Embree."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np

from insonify.extras import optional
from insonify.types import Array, Float32, Float64, Int32

_RAYS_A_THREAD = 2048


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First hits of a bundle of rays.

    Attributes:
        range_m: (N,) float32; infinite where nothing was hit.
        normal: (N, 3) float32, the triangle's normal, not normalised, either side.
        body: (N,) int32, index of the body hit; -1 where nothing was hit.
        triangle: (N,) int32, index of the triangle in its body; -1 where nothing was hit.
        uv: (N, 2) float32, barycentric weights of the triangle's second and third corner.
    """

    range_m: Float32
    normal: Float32
    body: Int32
    triangle: Int32
    uv: Float32


class RayTracer:
    """A set of triangle meshes that answers where rays first hit them.

    Embree works in float32, so the meshes are moved to their common middle first: at 10 m of
    extent that keeps positions to a micrometre wherever in the world they are.
    """

    def __init__(self, meshes: list[tuple[Float64, Int32]]) -> None:
        """Build from (vertices (N, 3) metres, faces (M, 3)) pairs; a body is its index.

        Raises:
            MissingExtraError: The package embreex is not installed.
        """
        corners = np.array([[v.min(axis=0), v.max(axis=0)] for v, _ in meshes])
        self._middle = (corners[:, 0].min(axis=0) + corners[:, 1].max(axis=0)) / 2
        meshing = optional("embreex.mesh_construction", "simulation", "tracing rays")
        self._scene = optional("embreex.rtcore_scene", "simulation", "tracing rays").EmbreeScene()
        for vertices, faces in meshes:
            local = np.ascontiguousarray(vertices - self._middle, dtype=np.float32)
            meshing.TriangleMesh(self._scene, local, np.ascontiguousarray(faces, dtype=np.int32))
        self._threads = numba.get_num_threads()  # one rule for rays and kernels
        self._pool: ThreadPoolExecutor | None = None

    def cast(self, origin_m: Float64, directions: Float32, limit_m: float = np.inf) -> Hits:
        """First hits of rays.

        Args:
            origin_m: One point (3,) or a point each (N, 3), world frame.
            directions: (N, 3) unit vectors.
            limit_m: Nothing farther away is looked for, which is faster.
        """
        local = np.asarray(origin_m - self._middle, dtype=np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(local, directions.shape))
        limits = np.full(len(directions), min(limit_m, 1e30), np.float32)
        directions = np.ascontiguousarray(directions, dtype=np.float32)
        found = self._run(origins, directions, limits)
        body: Int32 = found["geomID"]
        range_m = np.where(body >= 0, found["tfar"], np.float32(np.inf))
        uv = np.column_stack([found["u"], found["v"]])
        return Hits(range_m, found["Ng"], body, found["primID"], uv)

    def _run(self, origins: Float32, directions: Float32, limits: Float32) -> dict[str, Array]:
        """Embree's answer; many rays are shared among threads (Embree releases Python's lock)."""

        def part(start: int, stop: int) -> dict[str, Array]:
            answer: dict[str, Array] = self._scene.run(
                origins[start:stop], directions[start:stop], limits[start:stop],
                query="INTERSECT", output=1,
            )  # fmt: skip
            return answer

        count = len(directions)
        parts = min(self._threads, count // _RAYS_A_THREAD)
        if parts < 2 or not self._scene.is_committed:
            return part(0, count)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads)
        cuts = [count * k // parts for k in range(parts + 1)]
        answers = list(self._pool.map(part, cuts[:-1], cuts[1:]))
        return {key: np.concatenate([a[key] for a in answers]) for key in answers[0]}
