"""The colours of occupied voxels: from deep blue where in doubt to yellow where sure."""

from __future__ import annotations

import numpy as np

from insonify.types import Array, Float32

_CODES = (
    "440154 47186a 472c7b 424085 3a528b 32628d 2c728e 26818e 20908c 1e9f88 28ae7f 3ebc73 5ec961 "
    "83d34b addc30 d7e219 fde724"
)
_VIRIDIS = np.array([list(bytes.fromhex(code)) for code in _CODES.split(" ")], np.float64)
"""Of matplotlib's viridis each sixteenth, so that maps have colours without it."""


def probability_colours(probability: Float32) -> Array:
    """RGBA bytes (N, 4) of voxels by their probability, from 0.5 (or below it) to 1."""
    sure = np.clip(2.0 * np.asarray(probability, np.float64) - 1.0, 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(_VIRIDIS))
    found = np.full((len(sure), 4), 255, np.uint8)
    for channel in range(3):
        found[:, channel] = np.round(np.interp(sure, steps, _VIRIDIS[:, channel]))
    return found
