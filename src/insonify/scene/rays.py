"""Ray queries through Embree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from insonify.types import Float32, Float64, Int32


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First hits of a bundle of rays.

    Attributes:
        range_m: (N,) float32; infinite where nothing was hit.
        normal: (N, 3) float32, the triangle's normal, not normalised, either side.
        body: (N,) int32, index of the body hit; -1 where nothing was hit.
    """

    range_m: Float32
    normal: Float32
    body: Int32


class RayTracer:
    """A set of triangle meshes that answers where rays first hit them.

    Embree works in float32, so the meshes are moved to their common middle first: at 10 m of
    extent that keeps positions to a micrometre wherever in the world they are.
    """

    def __init__(self, meshes: list[tuple[Float64, Int32]]) -> None:
        """Build from (vertices (N, 3) metres, faces (M, 3)) pairs; a body is its index."""
        corners = np.array([[v.min(axis=0), v.max(axis=0)] for v, _ in meshes])
        self._middle = (corners[:, 0].min(axis=0) + corners[:, 1].max(axis=0)) / 2
        self._scene = rtcore_scene.EmbreeScene()
        for vertices, faces in meshes:
            local = np.ascontiguousarray(vertices - self._middle, dtype=np.float32)
            TriangleMesh(self._scene, local, np.ascontiguousarray(faces, dtype=np.int32))

    def cast(self, origin_m: Float64, directions: Float32) -> Hits:
        """First hits of rays from one point (3,) or a point each (N, 3); unit directions (N, 3)."""
        local = np.asarray(origin_m - self._middle, dtype=np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(local, directions.shape))
        found = self._scene.run(origins, directions, query="INTERSECT", output=1)
        body: Int32 = found["geomID"]
        range_m = np.where(body >= 0, found["tfar"], np.float32(np.inf))
        return Hits(range_m, found["Ng"], body)
