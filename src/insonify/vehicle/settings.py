"""All settings of a vehicle in a mission."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from insonify.config.settings import Settings
from insonify.vehicle.autopilot.control import ControlSettings
from insonify.vehicle.autopilot.guidance import GuidanceSettings
from insonify.vehicle.instruments import PoseNoiseSettings, SensorSettings
from insonify.vehicle.plant.currents import CurrentSettings

TELEPORT = "none"


class FaultSettings(Settings):
    """A sensor that fails in mid-mission."""

    sensor: Literal["none", "dvl", "imu", "sonar"] = Field(
        "none", description="dvl: no bottom lock; imu: no numbers; sonar: silent"
    )
    at_s: float = Field(0.0, ge=0, le=1e7, description="from this time on")


class VehicleSettings(Settings):
    """The vehicle that flies the scans, or none."""

    name: str = Field(
        TELEPORT, min_length=1, description="none (poses are taken as flown), a vehicle, or a file"
    )
    navigation: Literal["truth", "dvl"] = Field(
        "dvl", description="where it believes it is: the truth, or a filter on its sensors"
    )
    pose_noise: PoseNoiseSettings = PoseNoiseSettings()
    ping_hz: float = Field(2.0, gt=0, le=20, description="the sonar's rate")
    lost_m: float = Field(
        2.0, gt=0, le=1000, description="stop when the position's standard deviation exceeds it"
    )
    density_kg_m3: float = Field(1025.0, gt=900, lt=1200, description="of the water")
    current: CurrentSettings = CurrentSettings()
    guidance: GuidanceSettings = GuidanceSettings()
    control: ControlSettings = ControlSettings()
    sensors: SensorSettings = SensorSettings()
    fault: FaultSettings = FaultSettings()

    @model_validator(mode="after")
    def _noise_is_without_a_vehicle(self) -> Self:
        if self.is_noisy and self.name != TELEPORT:
            raise ValueError(
                f"pose_noise is for scans without a vehicle; {self.name!r} believes what its "
                "navigation tells it, so leave it out"
            )
        return self

    @property
    def is_noisy(self) -> bool:
        """Whether poses are off without a vehicle."""
        return self.pose_noise != PoseNoiseSettings()
