"""Scenarios: everything a run depends on, as validated data, and the named ones.

A config is built in layers: defaults, the scenario, a config file, single settings.  Each layer
is a nested table; unknown keys are errors.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from insonify.errors import ConfigError, MeshError
from insonify.frames import rotation_from_rpy
from insonify.mapping.bayes import MappingSettings
from insonify.planning.active import EntropyPlanner, EntropySettings
from insonify.planning.baselines import LawnmowerPlanner, UniformPlanner
from insonify.planning.decision import Planner, SurveyArea
from insonify.scene import Body, Material, Scene
from insonify.scene.meshes import load_mesh, place_mesh, scaled
from insonify.scene.objects import PROCEDURAL_OBJECTS
from insonify.scene.seabed import Seabed, procedural_seabed, raster_seabed
from insonify.sonar import RendererName, Sonar, renderer_named
from insonify.sonar.devices import Kind, SonarDevice, sonar_preset
from insonify.sonar.formation import ImageSettings
from insonify.sonar.sampling import SamplingSettings, even_samples
from insonify.types import Box
from insonify.vehicle.settings import VehicleSettings

MOST_SEABED_CELLS = 16_000_000
MOST_RAYS = 20_000_000
PLANNERS = ("entropy", "uniform", "lawnmower")
Table = dict[str, Any]


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ObjectSettings(_Settings):
    """The object that is scanned."""

    mesh: str = Field(
        "tetrapod", description="tetrapod, shipwreck, or a mesh file (OBJ, STL, PLY, GLB, DAE)"
    )
    scale: float = Field(1.0, gt=0, le=1e6, description="factor to metres")
    x_m: float = Field(0.0, ge=-1e5, le=1e5)
    y_m: float = Field(0.0, ge=-1e5, le=1e5)
    up: Literal["auto", "y", "z"] = Field(
        "auto", description="the file's upward axis; auto: y for glTF and COLLADA's Y_UP, else z"
    )
    roll_deg: float = Field(0.0, ge=-360, le=360, description="turned about x, y, z in this order")
    pitch_deg: float = Field(0.0, ge=-360, le=360)
    yaw_deg: float = Field(0.0, ge=-360, le=360)
    burial_m: float = Field(0.0, ge=0, le=100, description="depth of its base below the seabed")
    reflectance: float = Field(1.0, gt=0, le=10, description="R of its material")


class SeabedSettings(_Settings):
    """The seabed: smooth random relief, or a raster file."""

    raster: str = Field("", description="heights file (.npy, .tif, .png, .asc) instead of relief")
    size_m: float = Field(
        80.0, gt=0, le=10000, description="edge of the procedural seabed, around the object"
    )
    cell_m: float = Field(0.25, gt=0, le=100, description="grid spacing")
    depth_m: float = Field(20.0, ge=0, le=11000, description="mean depth; raster zero height")
    relief_m: float = Field(0.05, ge=0, le=100, description="standard deviation of height")
    correlation_m: float = Field(2.0, gt=0, le=1000, description="length scale of the relief")
    reflectance: float = Field(1.0, gt=0, le=10, description="R of its material")


class SurveySettings(_Settings):
    """The vehicle's order: where to look, how high, how often."""

    altitude_m: float = Field(5.0, gt=0, le=1000, description="height above the mean seabed")
    heading_deg: float = Field(0.0, ge=-360, le=360, description="yaw of the first scan; 0 is east")
    approach_m: float = Field(
        8.0, ge=0, le=10000, description="a scan starts so far before the designated area"
    )
    overrun_m: float = Field(2.0, ge=0, le=10000, description="and ends beyond its centre")
    waypoints: int = Field(40, ge=1, le=100000, description="k, pings a scan")
    margin_m: float = Field(3.0, ge=0, le=1000, description="designated area around the object")
    headroom_m: float = Field(0.5, ge=0, le=1000, description="designated area above the object")
    floor_m: float = Field(
        0.2, ge=-100, le=100, description="lowest height above the mean seabed that counts"
    )
    clearance_m: float = Field(
        0.4, gt=0, le=100, description="least distance of the vehicle to anything"
    )
    baseline_scans: int = Field(3, ge=1, le=1000, description="scans of uniform and lawnmower")


class Config(_Settings):
    """All that is needed to run a scan again."""

    scenario: str = Field("tetrapod", description="the scenario that this config started from")
    planner: Literal["entropy", "uniform", "lawnmower"] = "entropy"
    mapper: Literal["bayes"] = "bayes"
    seed: int = Field(0, ge=0, lt=2**63)
    renderer: RendererName = Field(RendererName.EMBREE, description="embree or opengl")
    object: ObjectSettings = ObjectSettings()
    seabed: SeabedSettings = SeabedSettings()
    survey: SurveySettings = SurveySettings()
    sonar: SonarDevice = SonarDevice()
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
    mapping: MappingSettings = MappingSettings()
    entropy: EntropySettings = EntropySettings()
    vehicle: VehicleSettings = VehicleSettings()


@cache
def scenarios() -> dict[str, Table]:
    """The named scenarios as they stand in ``scenarios.toml``: title, config, paper's figures."""
    text = resources.files("insonify").joinpath("scenarios.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def scenario_config(name: str, layers: Iterable[Table] = ()) -> Config:
    """The config of a scenario, with further layers of settings on top.

    Raises:
        ConfigError: There is no such scenario, or a setting is unknown or out of range.
    """
    known = scenarios()
    if name not in known:
        raise ConfigError(f"there is no scenario named {name!r}{_did_you_mean(name, known)}")
    table: Table = {"scenario": name}
    for layer in (known[name]["config"], *layers):
        if layer.get("scenario", name) != name:
            raise ConfigError(
                f"the settings are those of scenario {layer['scenario']!r}, not of {name!r}; name "
                f"{layer['scenario']!r}, or take the line `scenario` out of the file"
            )
        table = overlay(table, layer)
    if isinstance(table.get("sonar"), str):
        table["sonar"] = _mounted(table["sonar"])
    try:
        return Config.model_validate(table | {"scenario": name})
    except ValidationError as err:
        raise ConfigError(explain(err, Config)) from err


def read_config(path: Path) -> Table:
    """A config file as one layer of settings; a path in it is relative to the file.

    Raises:
        ConfigError: The file is missing or not TOML.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as err:
        raise ConfigError(f"{path}: there is no such config file; check the path") from err
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise ConfigError(f"{path}: cannot be read as TOML ({err})") from err
    for section, key in (("object", "mesh"), ("seabed", "raster"), ("vehicle", "name")):
        inner = table.get(section)
        if isinstance(inner, dict) and isinstance(inner.get(key), str):
            beside = path.parent / inner[key]
            if inner[key] and inner[key] not in PROCEDURAL_OBJECTS and beside.is_file():
                inner[key] = str(beside.absolute())
    return table


def parse_setting(text: str) -> Table:
    """One ``KEY=VALUE`` as a layer; the key is dotted, the value TOML, or else a string.

    Raises:
        ConfigError: There is no ``=`` in it.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set takes KEY=VALUE, as in mapping.voxel_m=0.2, not {text!r}")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value
    for part in reversed(key.strip().split(".")):
        parsed = {part: parsed}
    return dict(parsed)


def overlay(below: Table, above: Table) -> Table:
    """Nested tables merged, ``above`` winning.

    A sonar given by name stands for its preset, so that single settings can follow it.
    """
    merged = dict(below)
    for key, value in above.items():
        inner = merged.get(key)
        if key == "sonar" and isinstance(inner, str) and isinstance(value, dict):
            inner = _mounted(inner)
        if isinstance(value, dict) and isinstance(inner, dict):
            value = overlay(inner, value)
        merged[key] = value
    return merged


def _mounted(preset: str) -> Table:
    """A preset as settings, tilted as in Park et al. 2025 unless it says how it is mounted."""
    return sonar_preset(preset, tilt_deg=SonarDevice().tilt_deg).model_dump(mode="json")


def explain(err: ValidationError, model: type[BaseModel]) -> str:
    """The first of pydantic's complaints as one sentence."""
    first = err.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"there is no setting {key!r}{_did_you_mean(key, _all_keys(model))}"
    message = first["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    given = first.get("input")
    value = f", not {given!r}" if not isinstance(given, dict) else ""
    return f"setting {key}: {message}{value}; see `insonify config` for all settings"


def _all_keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    keys = []
    for name, field in model.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            keys += _all_keys(inner, f"{prefix}{name}.")
        else:
            keys.append(prefix + name)
    return keys


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    listing = f"choose one of {', '.join(names)}" if len(names) < 12 else "see `insonify config`"
    return f"; {listing}"


class World:
    """A scenario come to life: what there is, and what the vehicle is told to do about it."""

    def __init__(self, config: Config) -> None:
        """Build scene, sonar and designated area; the seed shapes the seabed.

        Raises:
            MeshError: The mesh or the raster cannot be used.
        """
        self.config = config
        self.seabed = self._build_seabed()
        self.body = self._place_object()
        self.scene = Scene((self.body,), self.seabed, Material("seabed", config.seabed.reflectance))
        renderer = renderer_named(config.renderer, config.sampling)
        self.sonar = Sonar(config.sonar, config.sampling, config.image, renderer)
        self.area = self._designate_area()
        self._check_area()

    def planner(self) -> Planner:
        """The planner that the config names."""
        survey = self.config.survey
        if self.config.planner == "uniform":
            return UniformPlanner(self.area, survey.baseline_scans)
        if self.config.planner == "lawnmower":
            return LawnmowerPlanner(self.area, survey.baseline_scans)
        return EntropyPlanner(self.area, self.config.sonar.geometry, self.config.entropy)

    def _build_seabed(self) -> Seabed:
        seabed = self.config.seabed
        if seabed.raster:
            path = Path(seabed.raster)
            return raster_seabed(path, cell_m=seabed.cell_m, depth_m=seabed.depth_m)
        cells = (seabed.size_m / seabed.cell_m) ** 2
        if cells > MOST_SEABED_CELLS:
            least_m = seabed.size_m / math.sqrt(MOST_SEABED_CELLS)
            raise ConfigError(
                f"a seabed of {seabed.size_m:g} m in cells of {seabed.cell_m:g} m has "
                f"{cells:.3g} cells, too many; cells of {least_m:.2g} m fit "
                "(--set seabed.cell_m=...)"
            )
        return procedural_seabed(
            np.random.default_rng([self.config.seed, 1]),
            size_m=seabed.size_m,
            depth_m=seabed.depth_m,
            relief_m=seabed.relief_m,
            correlation_m=seabed.correlation_m,
            cell_m=seabed.cell_m,
            centre_m=(self.config.object.x_m, self.config.object.y_m),
        )

    def _place_object(self) -> Body:
        """The object, standing on (or in) the seabed under its centre."""
        settings = self.config.object
        if settings.mesh in PROCEDURAL_OBJECTS:
            mesh = scaled(PROCEDURAL_OBJECTS[settings.mesh](), settings.scale)
        else:
            mesh = load_mesh(Path(settings.mesh), settings.scale, up=settings.up)
        if float(max(mesh.extents)) < self.config.mapping.voxel_m:
            raise MeshError(
                f"{settings.mesh}: the object is {max(mesh.extents):.2g} m across, smaller than "
                f"one voxel ({self.config.mapping.voxel_m:g} m); give its scale "
                "(--set object.scale=...) or smaller voxels (--set mapping.voxel_m=...)"
            )
        ground = self.seabed.height_at(np.array([settings.x_m]), np.array([settings.y_m]))
        base_z = float(ground[0]) - settings.burial_m
        angles = (settings.roll_deg, settings.pitch_deg, settings.yaw_deg)
        turn = rotation_from_rpy(*(math.radians(math.remainder(a, 360.0)) for a in angles))
        placed = place_mesh(mesh, settings.x_m, settings.y_m, base_z, turn)
        buried_z = self.seabed.height_at(placed.vertices[:, 0], placed.vertices[:, 1])
        if (placed.vertices[:, 2] <= buried_z).all():
            raise MeshError(
                f"{settings.mesh}: all of the object lies below the seabed at a burial of "
                f"{settings.burial_m:g} m; bury it less (--set object.burial_m=...)"
            )
        return Body(Path(settings.mesh).stem, placed, Material("object", settings.reflectance))

    def _designate_area(self) -> SurveyArea:
        """The order given to the vehicle: a box around where the object is known to lie."""
        survey = self.config.survey
        low, high = self.body.box.low_m, self.body.box.high_m
        level = float(self.seabed.heights_m.mean())
        margin = survey.margin_m
        region = Box(
            (low[0] - margin, low[1] - margin, level + survey.floor_m),
            (high[0] + margin, high[1] + margin, high[2] + survey.headroom_m),
        )
        return SurveyArea(
            region=region,
            z_m=level + survey.altitude_m,
            heading_rad=math.radians(survey.heading_deg),
            approach_m=survey.approach_m,
            overrun_m=survey.overrun_m,
            waypoints=survey.waypoints,
        )

    def _check_area(self) -> None:
        """Refuse orders that make no sense, before anything is flown.

        Raises:
            ConfigError: The area is empty, the vehicle would leave the water or the seabed, or the
                sonar would need more rays than memory holds.
        """
        survey, area, sonar = self.config.survey, self.area, self.config.sonar
        if sonar.kind is not Kind.FORWARD_LOOKING or sonar.azimuth_fov_deg > 180.0:
            raise ConfigError(
                f"a scan needs a forward-looking sonar of at most 180 degrees, and {sonar.name!r} "
                f"is a {sonar.kind} one of {sonar.azimuth_fov_deg:g}; see `insonify sonars`"
            )
        if area.region.low_m[2] >= area.region.high_m[2]:
            raise ConfigError(
                f"survey.floor_m ({survey.floor_m:g} m above the seabed) leaves nothing of the "
                "designated area below its top; lower it"
            )
        if area.z_m >= 0.0:
            raise ConfigError(
                f"survey.altitude_m ({survey.altitude_m:g} m) puts the vehicle at {area.z_m:g} m, "
                "above the water's surface; fly lower or make the seabed deeper (seabed.depth_m)"
            )
        heights = self.seabed.heights_m
        reach_m = survey.approach_m + max(area.region.size_m[:2]) / 2
        x, y, _ = area.region.centre_m
        spare_m = min(
            x - self.seabed.origin_m[0],
            y - self.seabed.origin_m[1],
            self.seabed.origin_m[0] + (heights.shape[1] - 1) * self.seabed.cell_m - x,
            self.seabed.origin_m[1] + (heights.shape[0] - 1) * self.seabed.cell_m - y,
        )
        if spare_m < reach_m:
            raise ConfigError(
                f"the seabed ends {max(spare_m, 0.0):.3g} m from the object and scans begin "
                f"{reach_m:.3g} m from it; take a larger one (seabed.size_m) or move the object"
            )
        rays = self.config.sonar.beams * math.prod(
            even_samples(self.config.sonar.geometry, self.config.sampling)
        )
        if rays > MOST_RAYS:
            raise ConfigError(
                f"the sampling asks for {rays:.3g} rays a ping, more than {MOST_RAYS:g}; lower "
                "sampling.across_beam or sampling.over_elevation (0 chooses)"
            )
