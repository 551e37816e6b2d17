"""What a scan depends on, as validated settings, and the world and order that they make."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from functools import cache
from typing import Any, Self

from pydantic import Field, model_validator

from insonify.config.layers import named_tables, overlaid
from insonify.config.settings import Settings, Table, did_you_mean, validated
from insonify.errors import ConfigError, MeshError
from insonify.imaging.settings import Imaging
from insonify.mapping.echoes import ambient_threshold
from insonify.mapping.factory import MAPPER_PARTS, MAPPERS, check_mapper, make_mapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.planning.active import EntropySettings
from insonify.planning.decision import Planner, SurveyArea
from insonify.planning.factory import PLANNER_PARTS, PLANNERS, Task, check_planner, make_planner
from insonify.planning.information import InformationSettings
from insonify.planning.rosette import RosetteSettings
from insonify.plugins import check_object, name_of
from insonify.scene import Scene
from insonify.scene.placing import FieldSettings, ObjectSettings
from insonify.scene.staged import SeabedSettings, Stage
from insonify.sonar import Sonar
from insonify.sonar.devices import Kind, SonarDevice, resolved_device
from insonify.sonar.sampling import even_samples
from insonify.types import Box
from insonify.vehicle.settings import VehicleSettings

MOST_RAYS = 20_000_000


_HUGE_M = 100.0
"""An object so large may be in other units."""


class SurveySettings(Settings):
    """The vehicle's order: where to look, how high, how often."""

    altitude_m: float = Field(5.0, gt=0, le=1000, description="height above the mean seabed")
    heading_deg: float = Field(0.0, ge=-360, le=360, description="yaw of the first scan; 0 is east")
    approach_m: float = Field(
        8.0, ge=0, le=10000, description="a scan starts so far before the designated area"
    )
    overrun_m: float = Field(2.0, ge=0, le=10000, description="and ends beyond its centre")
    waypoints: int = Field(40, ge=1, le=100000, description="k, pings a scan")
    margin_m: float = Field(3.0, ge=0, le=1000, description="designated area around the object")
    area_m: tuple[float, ...] = Field(
        (), description="designated area: x, y of a corner and x, y of the other; [] is around all"
    )
    headroom_m: float = Field(0.5, ge=0, le=1000, description="designated area above the object")
    floor_m: float = Field(
        0.2, ge=-100, le=100, description="lowest height above the mean seabed that counts"
    )
    clearance_m: float = Field(
        0.4, gt=0, le=100, description="least distance of the vehicle to anything"
    )
    baseline_scans: int = Field(3, ge=1, le=1000, description="scans of uniform and lawnmower")

    @model_validator(mode="after")
    def _area_is_one(self) -> Self:
        if not self.area_m:
            return self
        if len(self.area_m) != 4 or not all(abs(c) <= 1e5 for c in self.area_m):
            raise ValueError(f"area_m has four numbers, x0, y0, x1, y1, not {list(self.area_m)}")
        if self.area_m[0] >= self.area_m[2] or self.area_m[1] >= self.area_m[3]:
            raise ValueError(f"area_m holds nothing: x0 < x1, y0 < y1, not {list(self.area_m)}")
        return self


class Config(Imaging):
    """All that is needed to run a scan again."""

    scenario: str = Field("tetrapod", description="the scenario that this config started from")
    planner: str = Field(
        "entropy", description=", ".join(PLANNERS) + ", or your own: module:Name, file.py:Name"
    )
    mapper: str = Field(
        "bayes", description=", ".join(MAPPERS) + ", or your own: module:Name or file.py:Name"
    )
    objects: tuple[ObjectSettings, ...] = Field(
        (), max_length=200, description="several objects; each is as [object] but for what it says"
    )
    object: ObjectSettings = ObjectSettings()
    field: FieldSettings = FieldSettings()
    seabed: SeabedSettings = SeabedSettings()
    survey: SurveySettings = SurveySettings()
    mapping: MappingSettings = MappingSettings()
    entropy: EntropySettings = EntropySettings()
    rosette: RosetteSettings = RosetteSettings()
    information: InformationSettings = InformationSettings()
    vehicle: VehicleSettings = VehicleSettings()
    planner_options: dict[str, Any] = Field({}, description="of a planner of your own")
    mapper_options: dict[str, Any] = Field({}, description="of a mapper of your own")

    @model_validator(mode="before")
    @classmethod
    def _objects_are_like_the_object(cls, table: Any) -> Any:
        """What the tables of `objects` leave out is in that of `object`."""
        if not isinstance(table, dict) or not isinstance(table.get("objects"), list):
            return table
        like = table.get("object", {})
        like = like.model_dump() if isinstance(like, ObjectSettings) else like
        objects = [
            overlaid([like, one]) if isinstance(one, dict) and isinstance(like, dict) else one
            for one in table["objects"]
        ]
        return table | {"objects": objects}

    @model_validator(mode="after")
    def _echoes_are_above_the_noise(self) -> Self:
        """By the sonar equation the threshold follows from the noise, unless it is set."""
        if self.model == "physical" and "pixel_threshold" not in self.mapping.model_fields_set:
            sonar = Sonar(self.sonar, physical=self.physical, water=self.water)
            told = {
                "pixel_threshold": min(254, math.ceil(255 * ambient_threshold(sonar.ambient())))
            }
            object.__setattr__(self, "mapping", self.mapping.model_copy(update=told))
        return self


@cache
def scenarios() -> dict[str, Table]:
    """The named scenarios as they stand in ``scenarios.toml``: title, config, paper's figures."""
    return named_tables("scenarios")


def scenario_config(name: str, layers: Iterable[Table] = ()) -> Config:
    """The config of a scenario, with further layers of settings on top.

    Raises:
        ConfigError: There is no such scenario, or a setting is unknown or out of range.
    """
    known = scenarios()
    if name not in known:
        raise ConfigError(f"there is no scenario named {name!r}{did_you_mean(name, known)}")
    layers = list(layers)
    for layer in layers:
        if layer.get("scenario", name) != name:
            raise ConfigError(
                f"the settings are those of scenario {layer['scenario']!r}, not of {name!r}; name "
                f"{layer['scenario']!r}, or take the line `scenario` out of the file"
            )
    table = overlaid([{"sonar": {}}, known[name]["config"], *layers])
    table["sonar"] = resolved_device(table["sonar"], SonarDevice().tilt_deg)
    config = validated(Config, table | {"scenario": name})
    check_planner(config.planner, config.planner_options)
    check_mapper(config.mapper, config.mapper_options)
    return config


def naming(config: Config, planner: Planner | None, mapper: Mapper | None) -> Config:
    """A config that names the objects that are used in place of what it named, if any are.

    What else they were made with is not recorded.

    Raises:
        ConfigError: They are no such objects.
    """
    changes: Table = {}
    if planner is not None:
        check_object(planner, repr(planner), "planner", PLANNER_PARTS)
        changes |= {"planner": name_of(planner, PLANNERS), "planner_options": {}}
    if mapper is not None:
        check_object(mapper, repr(mapper), "mapper", MAPPER_PARTS)
        changes |= {"mapper": name_of(mapper, MAPPERS), "mapper_options": {}}
    return config.model_copy(update=changes)


def copied(mapper: Mapper) -> Mapper:
    """A second mapper, as empty as the first, for the same pings at the true poses.

    Raises:
        ConfigError: It cannot be copied.
    """
    try:
        return copy.deepcopy(mapper)
    except TypeError as err:
        raise ConfigError(
            f"mapper {mapper.name!r} cannot be copied ({err}), which a flown scan needs to say "
            "what its pose error costs; give it a __deepcopy__"
        ) from err


class World:
    """A scenario come to life: what there is, and what the vehicle is told to do about it.

    Attributes:
        config: The settings.
        stage: The objects on their seabed.
        sonar: The sonar.
        area: The order given to the vehicle.
    """

    def __init__(self, config: Config) -> None:
        """Build scene, sonar and designated area; the seed shapes the seabed.

        Raises:
            MeshError: The mesh or the raster cannot be used.
            ConfigError: The order makes no sense.
        """
        self.config = config
        self.stage = Stage(config.object, config.seabed, config.seed, config.objects, config.field)
        _check_size(self.stage, config)
        self.sonar = config.build(config.sonar)
        self.area = _designated_area(self.stage, config.survey)
        _check_sonar(config)
        _check_area(self.stage, self.area, config.survey)
        _check_rays(config)

    @property
    def scene(self) -> Scene:
        """What there is."""
        return self.stage.scene

    def planner(self) -> Planner:
        """The planner that the config names."""
        config = self.config
        task = Task(
            self.area,
            config.sonar.geometry,
            config.entropy,
            config.rosette,
            config.information,
            config.survey.baseline_scans,
            config.mapper,
            config.survey.clearance_m,
        )
        return make_planner(config.planner, task, config.planner_options)

    def mapper(self) -> Mapper:
        """The mapper that the config names, with an empty map."""
        return make_mapper(self.config.mapper, self.config.mapping, self.config.mapper_options)


def _designated_area(stage: Stage, survey: SurveySettings) -> SurveyArea:
    """The order given to the vehicle: a box around where the objects are known to lie."""
    box, level = stage.box, float(stage.seabed.heights_m.mean())
    if survey.area_m:
        x_0, y_0, x_1, y_1 = survey.area_m
    elif stage.field.count:
        x, y, half_m = stage.object.x_m, stage.object.y_m, stage.field.size_m / 2
        x_0, y_0, x_1, y_1 = x - half_m, y - half_m, x + half_m, y + half_m
    else:
        around = box.grown(survey.margin_m)
        x_0, y_0, x_1, y_1 = *around.low_m[:2], *around.high_m[:2]
    region = Box(
        (x_0, y_0, level + survey.floor_m),
        (x_1, y_1, box.high_m[2] + survey.headroom_m),
    )
    return SurveyArea(
        region=region,
        z_m=level + survey.altitude_m,
        heading_rad=math.radians(survey.heading_deg),
        approach_m=survey.approach_m,
        overrun_m=survey.overrun_m,
        waypoints=survey.waypoints,
    )


def _check_size(stage: Stage, config: Config) -> None:
    """Refuse an object that no voxel would show, most likely in other units."""
    small = min(zip(stage.meshes, stage.placed, strict=True), key=lambda one: max(one[0].extents))
    across_m = float(max(small[0].extents))
    if across_m < config.mapping.voxel_m:
        raise MeshError(
            f"{small[1].mesh}: the object is {across_m:.2g} m across, smaller than one voxel "
            f"({config.mapping.voxel_m:g} m); give its scale (--set object.scale=...) or smaller "
            "voxels (--set mapping.voxel_m=...)"
        )


def _check_sonar(config: Config) -> None:
    """Refuse a sonar that no scan can be made with."""
    sonar = config.sonar
    if sonar.kind is not Kind.FORWARD_LOOKING or sonar.azimuth_fov_deg > 180.0:
        raise ConfigError(
            f"a scan needs a forward-looking sonar of at most 180 degrees, and {sonar.name!r} "
            f"is a {sonar.kind} one of {sonar.azimuth_fov_deg:g}; see `insonify sonars`"
        )


def _check_area(stage: Stage, area: SurveyArea, survey: SurveySettings) -> None:
    """Refuse orders that make no sense, before anything is flown.

    Raises:
        ConfigError: The area is empty, or the vehicle would leave the water or the seabed.
    """
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
    seabed = stage.seabed
    reach_m = survey.approach_m + max(area.region.size_m[:2]) / 2
    x, y, _ = area.region.centre_m
    spare_m = min(
        x - seabed.origin_m[0],
        y - seabed.origin_m[1],
        seabed.origin_m[0] + (seabed.heights_m.shape[1] - 1) * seabed.cell_m - x,
        seabed.origin_m[1] + (seabed.heights_m.shape[0] - 1) * seabed.cell_m - y,
    )
    if spare_m < reach_m:
        raise ConfigError(
            f"the seabed ends {max(spare_m, 0.0):.3g} m from the area's middle and scans begin "
            f"{reach_m:.3g} m from it; take a larger one (seabed.size_m) or move the object"
            + _units_hint(max(float(max(mesh.extents)) for mesh in stage.meshes))
        )


def _units_hint(across_m: float) -> str:
    if across_m < _HUGE_M:
        return ""
    return f"; it is {across_m:.3g} m across, so if it is in millimetres, --set object.scale=0.001"


def _check_rays(config: Config) -> None:
    """Refuse a sampling that needs more rays than memory holds."""
    rays = config.sonar.beams * math.prod(even_samples(config.sonar.geometry, config.sampling))
    if rays > MOST_RAYS:
        raise ConfigError(
            f"the sampling asks for {rays:.3g} rays a ping, more than {MOST_RAYS:g}; lower "
            "sampling.across_beam or sampling.over_elevation (0 chooses)"
        )
