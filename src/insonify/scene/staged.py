"""A stage for a scan: objects standing on, or in, a seabed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from pydantic import Field

from insonify.config.settings import Settings
from insonify.errors import ConfigError, MeshError
from insonify.frames import rotation_from_rpy
from insonify.scene import Body, Material, Scene
from insonify.scene.meshes import place_mesh
from insonify.scene.placing import FieldSettings, ObjectSettings, object_mesh, scattered
from insonify.scene.seabed import Seabed, procedural_seabed, raster_seabed
from insonify.seeds import Stream, generator
from insonify.types import Box

MOST_SEABED_CELLS = 16_000_000


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
    """Objects on a seabed; the seed shapes the relief, scatters a field, turns and buries objects.

    Attributes:
        object: The object, if it is one; what those of a field have in common, and the middle.
        ground: The seabed.
        seed: Of relief and places.
        objects: Several instead of the one.
        field: More that are scattered by the seed.

    Raises:
        MeshError: When built: a mesh or the raster cannot be used.
        ConfigError: When built: the seabed would have too many cells, or the field is full.
    """

    object: ObjectSettings
    ground: SeabedSettings
    seed: int = 0
    objects: tuple[ObjectSettings, ...] = ()
    field: FieldSettings = FieldSettings()

    @cached_property
    def scene(self) -> Scene:
        """The world: the objects, then the seabed."""
        return Scene(self.bodies, self.seabed, Material("seabed", self.ground.reflectance))

    @cached_property
    def placed(self) -> tuple[ObjectSettings, ...]:
        """All objects, and where they stand."""
        if not self.field.count:
            return self.objects or (self.object,)
        rng = generator(self.seed, Stream.FIELD)
        return (*self.objects, *scattered(self.field, self.object, self.objects, rng))

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
    def meshes(self) -> tuple[trimesh.Trimesh, ...]:
        """The objects by themselves, metres."""
        return tuple(object_mesh(one) for one in self.placed)

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The objects, each standing on (or in) the seabed under its centre."""
        bodies: list[Body] = []
        for number, settings in enumerate(self.placed):
            name = Path(settings.mesh).stem
            again = sum(body.name.partition("#")[0] == name for body in bodies)
            bodies.append(self._body(settings, number, f"{name}#{again + 1}" if again else name))
        return tuple(bodies)

    @property
    def box(self) -> Box:
        """What holds all of them."""
        corners = [(body.box.low_m, body.box.high_m) for body in self.bodies]
        low_m, high_m = zip(*corners, strict=True)
        return Box.of(np.min(low_m, axis=0), np.max(high_m, axis=0))

    def _body(self, settings: ObjectSettings, number: int, name: str) -> Body:
        ground = self.seabed.height_at(np.array([settings.x_m]), np.array([settings.y_m]))
        aside, deeper = generator(self.seed, Stream.PLACE, number).uniform((-1.0, 0.0), 1.0)
        burial_m = settings.burial_m + deeper * settings.burial_spread_m
        base_z = float(ground[0]) - burial_m
        yaw_deg = settings.yaw_deg + aside * settings.yaw_spread_deg
        angles = (settings.roll_deg, settings.pitch_deg, yaw_deg)
        turn = rotation_from_rpy(*(math.radians(math.remainder(a, 360.0)) for a in angles))
        placed = place_mesh(self.meshes[number], settings.x_m, settings.y_m, base_z, turn)
        buried_z = self.seabed.height_at(placed.vertices[:, 0], placed.vertices[:, 1])
        if (placed.vertices[:, 2] <= buried_z).all():
            raise MeshError(
                f"{settings.mesh}: all of the object lies below the seabed at a burial of "
                f"{burial_m:.3g} m; bury it less (--set object.burial_m=...)"
            )
        return Body(name, placed, Material("object", settings.reflectance))
