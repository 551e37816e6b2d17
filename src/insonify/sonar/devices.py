"""Imaging sonars as data: a validated description, and the presets that come with it."""

from __future__ import annotations

import math
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from insonify.config.layers import named_tables, read_table
from insonify.config.settings import Settings, Table, did_you_mean, validated
from insonify.errors import ConfigError
from insonify.frames import compose
from insonify.types import FanGeometry, Pose

WORLDS = (".sdf", ".world", ".scn")
"""Files of simulated worlds, which may describe sonars (`insonify.sonar.described`)."""
LEAST_REACH_M = 0.1
_ABOUT = ("source", "unconfirmed")


class Kind(StrEnum):
    """What a device does with its beams."""

    FORWARD_LOOKING = "forward-looking"
    SCANNING = "scanning"
    SIDESCAN = "sidescan"
    PROFILING = "profiling"


class SonarDevice(Settings):
    """An imaging sonar: a fan of beams, each as high as the elevation field of view.

    - forward-looking (FLS): many beams side by side, an image a ping;
    - scanning (MSIS): one beam on a head that turns by a step after each ping;
    - sidescan: one beam to port and one to starboard, a line of the image a ping;
    - profiling: a thin fan across the track; each beam measures a range.

    Defaults are those of Park et al. 2025, Table 1.
    """

    name: str = Field("park-2025", description="what the device is called")
    kind: Kind = Field(
        Kind.FORWARD_LOOKING, description="forward-looking, scanning, sidescan or profiling"
    )
    azimuth_fov_deg: float = Field(29.0, gt=0, le=360, description="horizontal field of view")
    elevation_fov_deg: float = Field(14.0, gt=0, le=120, description="vertical field of view")
    beams: int = Field(96, ge=1, le=4096)
    bins: int = Field(513, ge=1, le=16384, description="range bins")
    range_min_m: float = Field(0.0, ge=0)
    range_max_m: float = Field(12.825, gt=0, le=1000)
    frequency_khz: float = Field(1800.0, gt=1, le=10000, description="for the physical model")
    beamwidth_deg: float = Field(
        0.0, ge=0, le=90, description="-3 dB width of a receive beam; 0: the beams' spacing"
    )
    range_resolution_m: float = Field(
        0.0, ge=0, le=10, description="length of a pulse in range; 0: a bin (physical model)"
    )
    reach_m: float = Field(
        0.0, ge=0, le=10000, description="where echoes sink into noise; 0: range_max_m (physical)"
    )
    headroom_db: float = Field(
        30.0, ge=0, le=200, description="from sand at 70 % of the reach to full scale (physical)"
    )
    display_gamma: float = Field(
        0.4, ge=0.05, le=1, description="the power of pressure that is shown (physical)"
    )
    tilt_deg: float = Field(30.0, ge=-90, le=90, description="mounted looking down by this angle")
    mount_m: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="mounted so far forward, to port and up on the vehicle"
    )
    roll_deg: float = Field(0.0, ge=-180, le=180, description="mounted rolled; 180: upside down")
    yaw_deg: float = Field(0.0, ge=-180, le=180, description="mounted turned to port")
    rate_hz: float = Field(
        0.0, ge=0, le=1000, description="pings a second at most; 0: as the sound's way allows"
    )
    step_deg: float = Field(
        1.8, gt=0, le=180, description="scanning: the head turns so far after each ping"
    )
    sector_deg: float = Field(
        360.0, gt=0, le=360, description="scanning: the head's sector, around straight ahead"
    )
    back_and_forth: bool = Field(
        False, description="scanning: the head turns round at the sector's ends"
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.range_max_m <= self.range_min_m:
            raise ValueError(
                f"range_max_m ({self.range_max_m:g}) must exceed range_min_m ({self.range_min_m:g})"
            )
        if 0.0 < self.reach_m < LEAST_REACH_M:
            raise ValueError(
                f"reach_m is {LEAST_REACH_M:g} or more, or 0 for range_max_m, not {self.reach_m:g}"
            )
        if self.beams > 1 and self.kind in {Kind.SCANNING, Kind.SIDESCAN}:
            raise ValueError(f"a {self.kind} sonar has one beam on each head, not {self.beams}")
        if self.step_deg > self.sector_deg:
            raise ValueError(
                f"step_deg ({self.step_deg:g}) must not exceed sector_deg ({self.sector_deg:g})"
            )
        return self

    @property
    def geometry(self) -> FanGeometry:
        """What the pixels of this device's images mean; of a scanning head, looking ahead."""
        return self.geometry_at(0.0)

    def geometry_at(self, head_rad: float) -> FanGeometry:
        """The same with the head turned to the left by an angle about its own upward axis."""
        return FanGeometry(
            azimuth_fov_rad=math.radians(self.azimuth_fov_deg),
            elevation_fov_rad=math.radians(self.elevation_fov_deg),
            beams=self.beams,
            bins=self.bins,
            range_min_m=self.range_min_m,
            range_max_m=self.range_max_m,
            mount=self._mount(head_rad),
        )

    def _mount(self, head_rad: float) -> Pose:
        """The head on the body.

        A side-scan's heads are turned first and then tilted.  Others turn on a tilted base: a
        scanning sonar tilted by 90 degrees scans the plane across the track.
        """
        roll, tilt, yaw = map(math.radians, (self.roll_deg, self.tilt_deg, self.yaw_deg))
        if self.kind is Kind.SIDESCAN:
            return Pose(*self.mount_m, roll, tilt, yaw + head_rad)
        base = Pose(*self.mount_m, roll, tilt, yaw)
        return base if head_rad == 0.0 else compose(base, Pose(0.0, 0.0, 0.0, yaw_rad=head_rad))

    def interval_s(self, sound_speed_mps: float) -> float:
        """Time from one ping to the next: the sound's way there and back, or the rate's cap."""
        travel_s = 2.0 * self.range_max_m / sound_speed_mps
        return max(travel_s, 1.0 / self.rate_hz) if self.rate_hz > 0.0 else travel_s


@cache
def sonar_presets() -> dict[str, Table]:
    """The presets' tables by name, as they stand in ``config/sonars.toml``, source and all."""
    return named_tables("sonars")


def resolved_device(told: Any, tilt_deg: float = 0.0) -> Any:
    """A device's settings as a user tells them, with those of the preset they name below them.

    Args:
        told: A table, which may name a ``preset`` (one known by name, or a TOML file of its own),
            or the preset's name alone.  What is neither is left for the settings' own check.
        tilt_deg: How it is mounted, unless the settings or the preset say so.

    Raises:
        ConfigError: There is no such preset or file.
    """
    if isinstance(told, str):
        told = {"preset": told}
    if not isinstance(told, dict):
        return told
    own = dict(told)
    preset = own.pop("preset", None)
    below: Table = {} if preset is None else _preset_table(str(preset))
    own_range_m = below.get("range_max_m")
    if isinstance(own_range_m, int | float) and own_range_m >= LEAST_REACH_M:
        below = {"reach_m": own_range_m} | below  # it reaches as far, whatever range is set
    return {"tilt_deg": tilt_deg} | below | own


def named_device(name: str, tilt_deg: float = 0.0) -> SonarDevice:
    """A preset, or the device described in a TOML file if the name ends in ``.toml``.

    Raises:
        ConfigError: There is no such preset or file, or a figure is unknown or out of range.
    """
    where = name if name.endswith(".toml") else ""
    table = resolved_device(name, tilt_deg)
    return validated(SonarDevice, table, where=where, see="`insonify sonars`")


def _preset_table(name: str) -> Table:
    if name.partition("#")[0].endswith(WORLDS):
        from insonify.sonar.described import described_sonar

        table = described_sonar(name)
    elif name.endswith(".toml"):
        table = {"name": Path(name).stem, **read_table(Path(name), "sonar file")}
    elif name in sonar_presets():
        table = {"name": name, **sonar_presets()[name]}
    else:
        raise ConfigError(
            f"there is no sonar named {name!r}"
            f"{did_you_mean(name, sonar_presets(), '`insonify sonars`')}"
        )
    return {key: value for key, value in table.items() if key not in _ABOUT}


def device_of(geometry: FanGeometry, name: str) -> SonarDevice:
    """The device whose fan has this geometry.

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
            mount_m=geometry.mount.position_m,
            roll_deg=math.degrees(geometry.mount.roll_rad),
            yaw_deg=math.degrees(geometry.mount.yaw_rad),
        )
    except ValidationError as err:
        raise ConfigError(f"{name}: no forward-looking sonar has this fan ({geometry})") from err
