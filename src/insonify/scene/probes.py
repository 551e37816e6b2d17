"""The world as a vehicle meets it: what its Doppler log's rays find, and what its hull touches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from insonify.scene import Scene
from insonify.types import Float32, Float64, Pose, ScanPath


def ray_query(scene: Scene) -> Callable[[Float64, Float32], tuple[Float64, Float64]]:
    """A function from rays, origin (3,) and unit directions (N, 3), to what they find.

    It returns ranges (N,) in metres, infinite where there is nothing, and the cosines (N,) of the
    angles between the rays and the normals of what is there.
    """

    def find(origin_m: Float64, directions: Float32) -> tuple[Float64, Float64]:
        hits = scene.cast(origin_m, directions)
        length = np.maximum(np.linalg.norm(hits.normal, axis=1), 1e-30)
        square = np.abs((hits.normal * directions).sum(axis=1)) / length
        return hits.range_m.astype(np.float64), square.astype(np.float64)

    return find


def hull_contact(scene: Scene, radius_m: float) -> Callable[[Pose], bool]:
    """A function from a pose to whether a sphere there touches, or lies in, anything."""

    def touches(pose: Pose) -> bool:
        return scene.first_collision(ScanPath((pose,)), radius_m) is not None

    return touches
