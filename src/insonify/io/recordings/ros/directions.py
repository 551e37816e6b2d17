"""What the directions of beams mean: the plane they lie in, and its axes in the message's frame.

A fan is as high above its plane as below, so the plane's side does not matter; which way its beams
run does.  Where TF tells the frame, the directions say all of it.  Where it does not, the frame is
one that drivers use, told by the plane:

- y-z: z ahead, y to port, so x down, as the Oculus driver, `sonar_image_proc` and the package's
  own conversion of older bags have it; the definition of marine_acoustic_msgs says x up, so y to
  starboard, which is what recordings of ours mean;
- x-y: x ahead, y to port, z up (REP 103), as the simulators of NPS and DAVE;
- x-z: z ahead, x to starboard, y down (an optical frame of REP 103).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.types import Float64

_Axis = tuple[int, int, int]
_Axes = tuple[_Axis, _Axis, _Axis, str]
_FLAT = 0.1
"""Beams may leave their plane by this sine."""
_CUSTOMS: dict[str, _Axes] = {
    "y-z": ((0, 0, 1), (0, 1, 0), (-1, 0, 0), "z ahead, y to port"),
    "x-y": ((1, 0, 0), (0, 1, 0), (0, 0, 1), "x ahead, y to port"),
    "x-z": ((0, 0, 1), (-1, 0, 0), (0, -1, 0), "z ahead, x to starboard"),
}
"""Ahead, to port and up in the frame, for each plane."""
_BY_DEFINITION: dict[str, _Axes] = {
    "y-z": ((0, 0, 1), (0, -1, 0), (1, 0, 0), "z ahead, y to starboard")
}


@dataclass(frozen=True, slots=True, eq=False)
class BeamPlane:
    """A fan of directions in a message's frame.

    Attributes:
        frame_from_sonar: (4, 4) rotation of the sonar (ahead, to port, up) in the frame.
        azimuths_rad: (beams,) of each beam, in the message's order, positive to port.
        frame_from_custom: (4, 4) rotation of the axes that drivers with such a plane mean.
        custom: Those axes in words.
    """

    frame_from_sonar: Float64
    azimuths_rad: Float64
    frame_from_custom: Float64
    custom: str


def beam_plane(vectors: Float64, *, by_definition: bool = False) -> BeamPlane:
    """The plane and azimuths of directions (beams, 3).

    Args:
        vectors: The directions, of any length but 0.
        by_definition: The sonar's axes are those of the message's definition, x up.

    Raises:
        ValueError: A direction has no length, they lie in no plane, or point back or aside.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    if len(vectors) == 0 or not (np.isfinite(vectors).all() and (lengths > 1e-6).all()):
        raise ValueError("a beam has no direction")
    units = vectors / lengths[:, None]
    middle = units.mean(axis=0)
    _, spread, axes = np.linalg.svd(np.concatenate([units, np.zeros((2, 3))]))
    normal = axes[2] if spread[1] > 1e-6 * spread[0] else None
    if normal is not None and np.abs(units @ normal).max() > _FLAT:
        raise ValueError("its beams do not lie in one plane")
    customs = _CUSTOMS | (_BY_DEFINITION if by_definition else {})
    plane, custom = _custom(customs, middle, normal)
    up = custom[:, 2]
    if normal is not None and abs(normal @ up) < 1.0 - 1e-10:
        up = normal * np.sign(normal @ up)
    elif normal is None and abs(middle @ up) > 1e-6:
        up = _unit(up - (up @ middle) * middle / (middle @ middle))
    ahead = _unit(custom[:, 0] - (custom[:, 0] @ up) * up)
    port = np.cross(up, ahead)
    azimuths = np.arctan2(units @ port, units @ ahead)
    words = f"in the {plane} plane of their frame: {customs[plane][3]}"
    return BeamPlane(_turn(np.stack([ahead, port, up], 1)), azimuths, _turn(custom), words)


def _custom(
    customs: dict[str, _Axes], middle: Float64, normal: Float64 | None
) -> tuple[str, Float64]:
    """The customary axes that fit best, (3, 3), and their plane."""
    best = 0.0
    found: tuple[str, Float64] | None = None
    for plane, (ahead, port, up, _) in customs.items():
        axes = np.array([ahead, port, up], np.float64).T
        forward = float(middle @ axes[:, 0])
        fit = forward if normal is None else abs(float(normal @ axes[:, 2]))
        if forward > 1e-6 and fit > best + 1e-6:
            best, found = fit, (plane, axes)
    if found is None:
        along = ", ".join(f"{c:.2f}" for c in middle)
        raise ValueError(f"its beams point along ({along}) of their frame, not along x or z")
    return found


def _unit(vector: Float64) -> Float64:
    return vector / np.linalg.norm(vector)


def _turn(rotation: Float64) -> Float64:
    transform = np.eye(4)
    transform[:3, :3] = rotation
    return transform
