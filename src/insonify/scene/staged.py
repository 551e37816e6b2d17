"""A stage for a scan: an object standing on, or in, a seabed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from pydantic import Field

from insonify.config.settings import Settings
from insonify.errors import ConfigError, MeshError
from insonify.frames import rotation_from_rpy
from insonify.scene import Body, Material, Scene
from insonify.scene.meshes import load_mesh, place_mesh, scaled
from insonify.scene.objects import PROCEDURAL_OBJECTS
from insonify.scene.seabed import Seabed, procedural_seabed, raster_seabed
from insonify.seeds import Stream, generator

MOST_SEABED_CELLS = 16_000_000


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


class SeabedSettings(Settings):
    """The seabed: smooth random relief, or a raster file."""

    raster: str = Field("", description="heights file (.npy, .tif, .png, .asc) instead of relief")
    size_m: float = Field(
        80.0, gt=0, le=10000, description="edge of the procedural seabed, around the object"
    )
    cell_m: float = Field(0.25, gt=0, le=100, description="grid spacing")
    depth_m: float = Field(20.0, ge=0, le=11000, description="mean depth; raster zero height")
    relief_m: float = Field(0.05, ge=0, le=100, description="standard deviation of height")
    correlation_m: float = Field(2.0, gt=0, le=1000, description="length scale of the relief")
    slope_deg: float = Field(0.0, ge=0, le=45, description="of the procedural seabed")
    slope_towards_deg: float = Field(
        0.0, ge=-360, le=360, description="where it rises to; 0 is east, 90 north"
    )
    reflectance: float = Field(1.0, gt=0, le=10, description="R of its material")


@dataclass(frozen=True)
class Stage:
    """An object on a seabed; the seed shapes the relief, and turns and buries the object.

    Raises:
        MeshError: When built: the mesh or the raster cannot be used.
        ConfigError: When built: the seabed would have too many cells.
    """

    object: ObjectSettings
    ground: SeabedSettings
    seed: int = 0

    @cached_property
    def scene(self) -> Scene:
        """The world: the object, then the seabed."""
        return Scene((self.body,), self.seabed, Material("seabed", self.ground.reflectance))

    @cached_property
    def seabed(self) -> Seabed:
        """The seabed alone."""
        settings = self.ground
        if settings.raster:
            path = Path(settings.raster)
            return raster_seabed(path, cell_m=settings.cell_m, depth_m=settings.depth_m)
        cells = (settings.size_m / settings.cell_m) ** 2
        if cells > MOST_SEABED_CELLS:
            least_m = settings.size_m / math.sqrt(MOST_SEABED_CELLS)
            raise ConfigError(
                f"a seabed of {settings.size_m:g} m in cells of {settings.cell_m:g} m has "
                f"{cells:.3g} cells, too many; cells of {least_m:.2g} m fit "
                "(--set seabed.cell_m=...)"
            )
        return procedural_seabed(
            generator(self.seed, Stream.SEABED),
            size_m=settings.size_m,
            depth_m=settings.depth_m,
            relief_m=settings.relief_m,
            correlation_m=settings.correlation_m,
            cell_m=settings.cell_m,
            centre_m=(self.object.x_m, self.object.y_m),
        ).tilted(math.radians(settings.slope_deg), math.radians(settings.slope_towards_deg))

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The object by itself, metres."""
        settings = self.object
        if settings.mesh in PROCEDURAL_OBJECTS:
            return scaled(PROCEDURAL_OBJECTS[settings.mesh](), settings.scale)
        return load_mesh(Path(settings.mesh), settings.scale, up=settings.up)

    @cached_property
    def body(self) -> Body:
        """The object, standing on (or in) the seabed under its centre."""
        settings = self.object
        ground = self.seabed.height_at(np.array([settings.x_m]), np.array([settings.y_m]))
        aside, deeper = generator(self.seed, Stream.PLACE).uniform((-1.0, 0.0), 1.0)
        burial_m = settings.burial_m + deeper * settings.burial_spread_m
        base_z = float(ground[0]) - burial_m
        yaw_deg = settings.yaw_deg + aside * settings.yaw_spread_deg
        angles = (settings.roll_deg, settings.pitch_deg, yaw_deg)
        turn = rotation_from_rpy(*(math.radians(math.remainder(a, 360.0)) for a in angles))
        placed = place_mesh(self.mesh, settings.x_m, settings.y_m, base_z, turn)
        buried_z = self.seabed.height_at(placed.vertices[:, 0], placed.vertices[:, 1])
        if (placed.vertices[:, 2] <= buried_z).all():
            raise MeshError(
                f"{settings.mesh}: all of the object lies below the seabed at a burial of "
                f"{burial_m:.3g} m; bury it less (--set object.burial_m=...)"
            )
        return Body(Path(settings.mesh).stem, placed, Material("object", settings.reflectance))
