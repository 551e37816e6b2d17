"""What a scan depends on, as validated settings, and the world and order that they make."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from typing import Any

from pydantic import Field

from insonify.config.layers import named_tables, overlaid
from insonify.config.settings import Settings, Table, did_you_mean, validated
from insonify.errors import ConfigError, MeshError
from insonify.imaging.settings import Imaging
from insonify.mapping.factory import MAPPER_PARTS, MAPPERS, check_mapper, make_mapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.planning.active import EntropySettings
from insonify.planning.decision import Planner, SurveyArea
from insonify.planning.factory import PLANNER_PARTS, PLANNERS, Task, check_planner, make_planner
from insonify.planning.rosette import RosetteSettings
from insonify.plugins import check_object, name_of
from insonify.scene import Scene
from insonify.scene.staged import ObjectSettings, SeabedSettings, Stage
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
    headroom_m: float = Field(0.5, ge=0, le=1000, description="designated area above the object")
    floor_m: float = Field(
        0.2, ge=-100, le=100, description="lowest height above the mean seabed that counts"
    )
    clearance_m: float = Field(
        0.4, gt=0, le=100, description="least distance of the vehicle to anything"
    )
    baseline_scans: int = Field(3, ge=1, le=1000, description="scans of uniform and lawnmower")


class Config(Imaging):
    """All that is needed to run a scan again."""

    scenario: str = Field("tetrapod", description="the scenario that this config started from")
    planner: str = Field(
        "entropy", description=", ".join(PLANNERS) + ", or your own: module:Name, file.py:Name"
    )
    mapper: str = Field(
        "bayes", description=", ".join(MAPPERS) + ", or your own: module:Name or file.py:Name"
    )
    object: ObjectSettings = ObjectSettings()
    seabed: SeabedSettings = SeabedSettings()
    survey: SurveySettings = SurveySettings()
    mapping: MappingSettings = MappingSettings()
    entropy: EntropySettings = EntropySettings()
    rosette: RosetteSettings = RosetteSettings()
    vehicle: VehicleSettings = VehicleSettings()
    planner_options: dict[str, Any] = Field({}, description="of a planner of your own")
    mapper_options: dict[str, Any] = Field({}, description="of a mapper of your own")


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


class World:
    """A scenario come to life: what there is, and what the vehicle is told to do about it.

    Attributes:
        config: The settings.
        stage: The object on its seabed.
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
        self.stage = Stage(config.object, config.seabed, config.seed)
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
            config.survey.baseline_scans,
            config.mapper,
        )
        return make_planner(config.planner, task, config.planner_options)

    def mapper(self) -> Mapper:
        """The mapper that the config names, with an empty map."""
        return make_mapper(self.config.mapper, self.config.mapping, self.config.mapper_options)


def _designated_area(stage: Stage, survey: SurveySettings) -> SurveyArea:
    """The order given to the vehicle: a box around where the object is known to lie."""
    low, high = stage.body.box.low_m, stage.body.box.high_m
    level = float(stage.seabed.heights_m.mean())
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


def _check_size(stage: Stage, config: Config) -> None:
    """Refuse an object that no voxel would show, most likely in other units."""
    across_m = float(max(stage.mesh.extents))
    if across_m < config.mapping.voxel_m:
        raise MeshError(
            f"{config.object.mesh}: the object is {across_m:.2g} m across, smaller than one voxel "
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
            f"the seabed ends {max(spare_m, 0.0):.3g} m from the object and scans begin "
            f"{reach_m:.3g} m from it; take a larger one (seabed.size_m) or move the object"
            + _units_hint(float(max(stage.mesh.extents)))
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
