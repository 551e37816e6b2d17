"""Small kernels that those of several rooms call: rotations and products of three."""

from __future__ import annotations

import numpy as np

from insonify.jit import kernel
from insonify.types import Float64


@kernel
def rotation_into(attitude: Float64, out: Float64) -> None:
    """Rotation matrix of a unit quaternion, scalar first, into ``out`` (3, 3)."""
    w, x, y, z = attitude[0], attitude[1], attitude[2], attitude[3]
    out[0, 0] = 1 - 2 * (y * y + z * z)
    out[0, 1] = 2 * (x * y - w * z)
    out[0, 2] = 2 * (x * z + w * y)
    out[1, 0] = 2 * (x * y + w * z)
    out[1, 1] = 1 - 2 * (x * x + z * z)
    out[1, 2] = 2 * (y * z - w * x)
    out[2, 0] = 2 * (x * z - w * y)
    out[2, 1] = 2 * (y * z + w * x)
    out[2, 2] = 1 - 2 * (x * x + y * y)


@kernel
def cross(a: Float64, b: Float64) -> Float64:
    """The cross product of two vectors (3,)."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out
