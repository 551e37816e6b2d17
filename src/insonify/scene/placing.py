"""What stands on a seabed, and where: one object, a list of them, or a field drawn by the seed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from pydantic import Field

from insonify.config.settings import Settings
from insonify.errors import ConfigError
from insonify.scene.meshes import load_mesh, scaled
from insonify.scene.objects import PROCEDURAL_OBJECTS

_TRIES = 2000
"""Places that are drawn for an object before the field is called full."""


class ObjectSettings(Settings):
    """The object that is scanned."""

    mesh: str = Field(
        "tetrapod",
        description=", ".join(PROCEDURAL_OBJECTS) + ", or a mesh file (OBJ, STL, PLY, GLB, DAE)",
    )
    scale: float = Field(1.0, gt=0, le=1e6, description="factor to metres")
    x_m: float = Field(0.0, ge=-1e5, le=1e5)
    y_m: float = Field(0.0, ge=-1e5, le=1e5)
    up: Literal["auto", "x", "y", "z"] = Field(
        "auto", description="the file's upward axis; auto: y for glTF, what COLLADA says, else z"
    )
    roll_deg: float = Field(0.0, ge=-360, le=360, description="turned about x, y, z in this order")
    pitch_deg: float = Field(0.0, ge=-360, le=360)
    yaw_deg: float = Field(0.0, ge=-360, le=360)
    burial_m: float = Field(0.0, ge=0, le=100, description="depth of its base below the seabed")
    yaw_spread_deg: float = Field(
        0.0, ge=0, le=180, description="turned by up to so much more to either side, by the seed"
    )
    burial_spread_m: float = Field(
        0.0, ge=0, le=100, description="buried by up to so much more, by the seed"
    )
    reflectance: float = Field(1.0, gt=0, le=10, description="R of its material")


class FieldSettings(Settings):
    """Objects that the seed scatters over a square, the designated area.

    Each is as `ObjectSettings` say but for what it is and where it stands.
    """

    count: int = Field(0, ge=0, le=200, description="how many; 0: there is no field")
    count_spread: int = Field(0, ge=0, le=200, description="up to so many more, by the seed")
    kinds: tuple[str, ...] = Field(
        tuple(kind for kind in PROCEDURAL_OBJECTS if kind != "shipwreck"),
        min_length=1,
        description="as object.mesh; taken in turn, shuffled by the seed",
    )
    size_m: float = Field(
        40.0, gt=0, le=10000, description="edge of the square, around object.x_m and y_m"
    )
    apart_m: float = Field(2.0, ge=0, le=1000, description="free water between two of them")


def object_mesh(settings: ObjectSettings) -> trimesh.Trimesh:
    """An object by itself, metres.

    Raises:
        MeshError: The file cannot be used.
    """
    if settings.mesh in PROCEDURAL_OBJECTS:
        return scaled(PROCEDURAL_OBJECTS[settings.mesh](), settings.scale)
    return load_mesh(Path(settings.mesh), settings.scale, up=settings.up)


def scattered(
    field: FieldSettings,
    like: ObjectSettings,
    taken: tuple[ObjectSettings, ...],
    rng: np.random.Generator,
) -> tuple[ObjectSettings, ...]:
    """Objects at places of a square, drawn one after another where there is room.

    An object takes the circle around its bounding box, however it is turned.

    Args:
        field: How many of what, and how large the square.
        like: What they have in common, and the square's centre.
        taken: Objects that stand already.
        rng: Where kinds and places come from.

    Raises:
        ConfigError: There is no room for so many.
        MeshError: A file cannot be used.
    """
    count = field.count + int(rng.integers(field.count_spread, endpoint=True))
    radii_m: dict[str, float] = {}
    circles = [(one.x_m, one.y_m, _radius_m(one, {})) for one in taken]
    placed: list[ObjectSettings] = []
    kinds: list[str] = []
    while len(placed) < count:
        kinds = kinds or list(rng.permutation(np.array(field.kinds, dtype=object)))
        one = like.model_copy(update={"mesh": str(kinds.pop())})
        radius_m = _radius_m(one, radii_m)
        free_m = field.size_m / 2 - radius_m
        for x, y in rng.uniform(-1.0, 1.0, (_TRIES, 2)).tolist():
            x_m, y_m = like.x_m + x * free_m, like.y_m + y * free_m
            gaps = (math.dist((x_m, y_m), (a, b)) - radius_m - r for a, b, r in circles)
            if free_m >= 0.0 and all(gap >= field.apart_m for gap in gaps):
                break
        else:
            raise ConfigError(
                f"a field of {field.size_m:g} m has no room for {count} objects {field.apart_m:g} "
                f"m apart ({len(placed)} stand); make it larger (field.size_m), or take fewer "
                "(field.count)"
            )
        circles.append((x_m, y_m, radius_m))
        placed.append(one.model_copy(update={"x_m": x_m, "y_m": y_m}))
    return tuple(placed)


def _radius_m(one: ObjectSettings, known: dict[str, float]) -> float:
    """Of the circle around an object's bounding box, seen from above."""
    if one.mesh not in known:
        size = object_mesh(one).extents
        tilted = one.roll_deg or one.pitch_deg
        known[one.mesh] = float(np.linalg.norm(size if tilted else size[:2])) / 2
    return known[one.mesh]
