"""Speckle of a sonar, which changes as it moves."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from insonify.frames import transform_from_pose
from insonify.types import Float32, Pose


@dataclass(slots=True)
class SpeckleField:
    """Speckle of one sonar, which changes as it moves.

    The field of a cell is complex Gaussian.  It keeps a correlation of
    ``exp(-(d / d0)^2 - (a / a0)^2)`` when the sonar moves by d and turns by a, with d0 half the
    length of the aperture that the beamwidth implies and a0 half the beamwidth: a sonar at rest
    sees the same speckle again.  With K speckle a cell has a texture too, which it keeps with that
    probability, squared.

    Attributes:
        pose: Of the last ping.
        amplitude: (2, beams, bins) float32, the field's real and imaginary part.
        texture: (beams, bins) float32.
    """

    pose: Pose | None = None
    amplitude: Float32 = field(default_factory=lambda: np.zeros((2, 0, 0), np.float32))
    texture: Float32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    def move(
        self, shape: tuple[int, int], pose: Pose, beam_rad: float, wavelength_m: float
    ) -> float:
        """Go on to the pose of the next ping, of (beams, bins); how much the field keeps."""
        kept = 0.0
        if self.pose is not None and self.texture.shape == shape:
            kept = _correlation(self.pose, pose, beam_rad, wavelength_m)
        if self.texture.shape != shape:
            self.amplitude = np.zeros((2, *shape), np.float32)
            self.texture = np.zeros(shape, np.float32)
        self.pose = pose
        return kept


def _correlation(before: Pose, now: Pose, beam_rad: float, wavelength_m: float) -> float:
    moved_m = math.dist(before.position_m, now.position_m)
    turned = transform_from_pose(before)[:3, :3].T @ transform_from_pose(now)[:3, :3]
    turned_rad = math.acos(min(1.0, max(-1.0, (float(np.trace(turned)) - 1.0) / 2.0)))
    aperture_m = 0.886 * wavelength_m / beam_rad
    if moved_m == 0.0 and turned_rad < 1e-7:
        return 1.0
    far = (2.0 * moved_m / aperture_m) ** 2 + (2.0 * turned_rad / beam_rad) ** 2
    return math.exp(-far) if far < 30.0 else 0.0
