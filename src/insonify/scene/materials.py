"""What surfaces are made of: how strongly they echo, and the small relief on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from insonify.config.layers import named_tables, read_table
from insonify.errors import ConfigError, MeshError
from insonify.jit import parallel_kernel, prange
from insonify.limits import LAMBERT_DB, LARGEST_REFLECTANCE
from insonify.pictures import opened_picture
from insonify.types import Float32, Float64, Int32

STEEL = (1.40, -5.5)
"""Reflectance and Lambert coefficient that tie the two scales together."""


@dataclass(frozen=True, slots=True)
class Material:
    """How strongly a surface echoes.

    Args:
        name: What it is called.
        reflectance: R of Cerqueira et al. 2017, section 3.2; positive.
        lambert_db: 10 log10(mu) of Lambert's law; by default what belongs to R, on the scale
            on which steel has R = 1.40.
    """

    name: str
    reflectance: float = 1.0
    lambert_db: float = math.nan

    def __post_init__(self) -> None:
        if not 0.0 < self.reflectance <= LARGEST_REFLECTANCE:
            raise ConfigError(
                f"material {self.name!r:.80}: reflectance must be a positive number up to "
                f"{LARGEST_REFLECTANCE:g}, not {self.reflectance:g}"
            )
        least_db, most_db = LAMBERT_DB
        if math.isnan(self.lambert_db):
            level = STEEL[1] + 20.0 * math.log10(self.reflectance / STEEL[0])
            object.__setattr__(self, "lambert_db", max(min(level, -5.0), least_db))
        if not least_db <= self.lambert_db <= most_db:
            raise ConfigError(
                f"material {self.name!r:.80}: lambert_db must lie between {least_db:g} and "
                f"{most_db:g}, not {self.lambert_db:g}"
            )


@cache
def material_table() -> dict[str, dict[str, Any]]:
    """The named materials as they stand in ``config/materials.toml``, source and all."""
    return named_tables("materials")


def material_named(name: str, own: Mapping[str, Material] | None = None) -> Material | None:
    """The material of a name, or the one whose name is a part of it (``SandAndStones``: sand).

    Args:
        name: In any case.
        own: A user's materials; they go before the named ones.
    """
    word = name.lower()
    for key, material in (own or {}).items():
        if key.lower() == word:
            return material
    for key, row in material_table().items():
        if key in word:
            return Material(key, row["reflectance"], row["lambert_db"])
    return None


def material_colour(name: str) -> tuple[float, float, float]:
    """Linear red, green, blue of the named material that a name contains, or of the default."""
    known = material_named(name) or Material("default")
    red, green, blue = material_table()[known.name]["colour"]
    return red, green, blue


def read_materials(path: Path) -> dict[str, Material]:
    """A user's table of materials: TOML, ``[name]`` with ``reflectance`` and/or ``lambert_db``.

    Raises:
        ConfigError: The file is missing, no TOML, or a value is unusable.
    """
    found = {}
    for name, row in read_table(path, "file of materials").items():
        known = {"reflectance", "lambert_db", "source"}
        if not isinstance(row, dict) or not set(row) <= known:
            raise ConfigError(f"{path}: [{name}] may hold {', '.join(sorted(known))} only")
        try:
            reflectance, level = float(row.get("reflectance", 1.0)), row.get("lambert_db")
            found[name] = Material(name, reflectance, math.nan if level is None else float(level))
        except (TypeError, ValueError) as err:
            raise ConfigError(f"{path}: [{name}] holds what is not a number ({err})") from err
    return found


@dataclass(frozen=True, slots=True, eq=False)
class NormalMap:
    """A tangent-space normal map and where it lies on a mesh (Cerqueira et al. 2017, section 3.2).

    Args:
        normals: (height, width, 3) float32, x along u, y along v, z out of the surface; row 0 is
            v = 0, and the map repeats.
        uv: (vertices, 2) texture coordinates of the mesh.
    """

    normals: Float32
    uv: Float64


def read_normal_map(path: Path) -> Float32:
    """The normals of an image file, for `NormalMap.normals`.

    Red, green and blue are x, y, z from -1 to 1; the image's last row is v = 0.

    Raises:
        MeshError: The file cannot be read as a picture.
    """
    with opened_picture(path, "a normal map", MeshError) as picture:
        colours = np.asarray(picture.convert("RGB"), dtype=np.float32)
    return np.ascontiguousarray(colours[::-1] / np.float32(127.5) - np.float32(1.0))


@parallel_kernel
def bend_normals(
    normal: Float32,
    rays: Float32,
    mask: Int32,
    triangle: Int32,
    barycentric: Float32,
    corners: Float32,
    uvs: Float32,
    normals: Float32,
) -> None:
    """Replace the normals of hits on one mesh by those of its normal map, in place.

    The tangent T and bitangent B of a triangle follow from how its texture lies on it; the map's
    normal (x, y, z) becomes x T + y B + z N, N facing the sonar (the TBN matrix).

    Args:
        normal: (N, 3), of all hits; only those of ``mask`` are written, normalised.
        rays: (N, 3) directions.
        mask: Indices of the hits on this mesh.
        triangle: (N,) triangle hit.
        barycentric: (N, 2) weights of its second and third corner.
        corners: (triangles, 3, 3) metres.
        uvs: (triangles, 3, 2).
        normals: (height, width, 3).
    """
    height, width = normals.shape[:2]
    for i in prange(len(mask)):
        k = mask[i]
        t = triangle[k]
        e1, e2 = corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0]
        d1, d2 = uvs[t, 1] - uvs[t, 0], uvs[t, 2] - uvs[t, 0]
        area = d1[0] * d2[1] - d1[1] * d2[0]
        n = np.array(
            [
                e1[1] * e2[2] - e1[2] * e2[1],
                e1[2] * e2[0] - e1[0] * e2[2],
                e1[0] * e2[1] - e1[1] * e2[0],
            ]
        )
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if area == 0.0 or length == 0.0:
            continue
        n /= length
        if n[0] * rays[k, 0] + n[1] * rays[k, 1] + n[2] * rays[k, 2] > 0.0:
            n = -n
        along_u = (e1 * d2[1] - e2 * d1[1]) / area
        along_v = (e2 * d1[0] - e1 * d2[0]) / area
        size = math.sqrt(along_u[0] ** 2 + along_u[1] ** 2 + along_u[2] ** 2)
        if size == 0.0:
            continue
        tangent = along_u / size
        side = np.array(
            [
                n[1] * tangent[2] - n[2] * tangent[1],
                n[2] * tangent[0] - n[0] * tangent[2],
                n[0] * tangent[1] - n[1] * tangent[0],
            ]
        )
        if side[0] * along_v[0] + side[1] * along_v[1] + side[2] * along_v[2] < 0.0:
            side = -side
        u = uvs[t, 0, 0] + barycentric[k, 0] * d1[0] + barycentric[k, 1] * d2[0]
        v = uvs[t, 0, 1] + barycentric[k, 0] * d1[1] + barycentric[k, 1] * d2[1]
        x, y = u * width - 0.5, v * height - 0.5
        x0, y0 = math.floor(x), math.floor(y)
        fx, fy = np.float32(x - x0), np.float32(y - y0)
        i0, i1 = int(x0) % width, (int(x0) + 1) % width
        j0, j1 = int(y0) % height, (int(y0) + 1) % height
        one = np.float32(1.0)
        m = (one - fy) * ((one - fx) * normals[j0, i0] + fx * normals[j0, i1])
        m += fy * ((one - fx) * normals[j1, i0] + fx * normals[j1, i1])
        for axis in range(3):
            normal[k, axis] = m[0] * tangent[axis] + m[1] * side[axis] + m[2] * n[axis]
