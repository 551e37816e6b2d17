"""Forward-looking sonars as data: a validated description, and the presets that come with it."""

from __future__ import annotations

import math
import tomllib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from insonify.errors import ConfigError
from insonify.types import FanGeometry, Pose


class SonarDevice(BaseModel):
    """A forward-looking imaging sonar: a fan of beams, each as high as the elevation field of view.

    Defaults are those of Park et al. 2025, Table 1.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field("park-2025", description="what the device is called")
    azimuth_fov_deg: float = Field(29.0, gt=0, le=180, description="horizontal field of view")
    elevation_fov_deg: float = Field(14.0, gt=0, le=120, description="vertical field of view")
    beams: int = Field(96, ge=1, le=4096)
    bins: int = Field(513, ge=1, le=16384, description="range bins")
    range_min_m: float = Field(0.0, ge=0)
    range_max_m: float = Field(12.825, gt=0, le=1000)
    frequency_khz: float = Field(1800.0, gt=1, le=10000, description="for the physical model")
    tilt_deg: float = Field(30.0, ge=-90, le=90, description="mounted looking down by this angle")

    @model_validator(mode="after")
    def _ranges_in_order(self) -> Self:
        if self.range_max_m <= self.range_min_m:
            raise ValueError(
                f"range_max_m ({self.range_max_m:g}) must exceed range_min_m ({self.range_min_m:g})"
            )
        return self

    @property
    def geometry(self) -> FanGeometry:
        """What the pixels of this device's images mean."""
        return FanGeometry(
            azimuth_fov_rad=math.radians(self.azimuth_fov_deg),
            elevation_fov_rad=math.radians(self.elevation_fov_deg),
            beams=self.beams,
            bins=self.bins,
            range_min_m=self.range_min_m,
            range_max_m=self.range_max_m,
            mount=Pose(0.0, 0.0, 0.0, pitch_rad=math.radians(self.tilt_deg)),
        )


@cache
def sonar_presets() -> dict[str, dict[str, Any]]:
    """The presets' tables by name, as they stand in ``presets.toml``, source and all."""
    text = resources.files("insonify.sonar").joinpath("presets.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def sonar_preset(name: str) -> SonarDevice:
    """The preset of a name.

    Raises:
        ConfigError: There is none of that name.
    """
    presets = sonar_presets()
    if name not in presets:
        known = ", ".join(sorted(presets))
        raise ConfigError(f"there is no sonar named {name!r}; choose one of {known}")
    fields = {key: value for key, value in presets[name].items() if key != "source"}
    return SonarDevice(name=name, **fields)


def read_device(path: Path) -> SonarDevice:
    """A device described in a TOML file of its own.

    Raises:
        ConfigError: The file is missing, not TOML, or a figure is unknown or out of range.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as err:
        raise ConfigError(f"{path}: there is no such sonar file; check the path") from err
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise ConfigError(f"{path}: cannot be read as TOML ({err})") from err
    try:
        return SonarDevice.model_validate({"name": path.stem, **table})
    except ValidationError as err:
        first = err.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the description"
        raise ConfigError(f"{path}: {key}: {first['msg'].lower()}; see `insonify sonars`") from err


def named_device(name: str) -> SonarDevice:
    """A preset, or the device described in a TOML file if the name ends in ``.toml``.

    Raises:
        ConfigError: There is no such preset or file.
    """
    return read_device(Path(name)) if name.endswith(".toml") else sonar_preset(name)


def device_of(geometry: FanGeometry, name: str) -> SonarDevice:
    """The device whose fan has this geometry, as far as a device tells it: of its mount the tilt.

    Raises:
        ConfigError: No forward-looking sonar has such a fan.
    """
    try:
        return SonarDevice(
            name=name,
            azimuth_fov_deg=math.degrees(geometry.azimuth_fov_rad),
            elevation_fov_deg=math.degrees(geometry.elevation_fov_rad),
            beams=geometry.beams,
            bins=geometry.bins,
            range_min_m=geometry.range_min_m,
            range_max_m=geometry.range_max_m,
            tilt_deg=math.degrees(geometry.tilt_rad),
        )
    except ValidationError as err:
        raise ConfigError(f"{name}: no forward-looking sonar has this fan ({geometry})") from err
