"""What a mapper is, what its map can be asked, and which mappers there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self, runtime_checkable

from pydantic import Field, model_validator

from insonify.config.settings import Settings
from insonify.errors import ConfigError
from insonify.limits import LEAST_VOXEL_M
from insonify.mapping.voxels import VoxelMap
from insonify.types import Array, FanGeometry, Float32, Float64, Ping, Pose


class BayesSettings(Settings):
    """The inverse sensor model of `bayes`."""

    p_occupied: float = Field(
        0.56, gt=0.5, lt=1, description="p(occupied | the voxel's arc has an echo)"
    )
    p_free: float = Field(
        0.05, gt=0, lt=0.5, description="p(occupied | silence before the first echo)"
    )
    p_min: float = Field(0.001, gt=0, lt=0.5, description="lower clamp of the probability")
    p_max: float = Field(0.98, gt=0.5, lt=1, description="upper clamp of the probability")

    @model_validator(mode="after")
    def _evidence_inside_clamps(self) -> Self:
        if self.p_free < self.p_min or self.p_occupied > self.p_max:
            raise ValueError(
                f"p_free ({self.p_free:g}) and p_occupied ({self.p_occupied:g}) must lie between "
                f"p_min ({self.p_min:g}) and p_max ({self.p_max:g})"
            )
        return self


class CarvingSettings(Settings):
    """Settings of `carving`."""

    inside: int = Field(
        2, ge=1, le=4, description="voxels inside, along the edge of one of the map's"
    )


class MappingSettings(Settings):
    """What every mapper needs, and a table for each mapper's own."""

    voxel_m: float = Field(0.1, ge=LEAST_VOXEL_M, le=100, description="edge length of a voxel")
    pixel_threshold: int = Field(
        76,
        ge=0,
        le=254,
        description="of 255; brighter pixels are echoes (Table 1); physical: noise says",
    )
    bayes: BayesSettings = BayesSettings()
    carving: CarvingSettings = CarvingSettings()

    @model_validator(mode="before")
    @classmethod
    def _older_files(cls, table: Any) -> Any:
        """Version 0.1 had the figures of `bayes` in the table of all mappers."""
        if not isinstance(table, dict):
            return table
        moved = {key: table[key] for key in BayesSettings.model_fields if key in table}
        if not moved:
            return table
        kept = {key: value for key, value in table.items() if key not in moved}
        return kept | {"bayes": moved | dict(kept.get("bayes", {}))}


class Belief(Protocol):
    """What is known of the world so far: what a planner sees of a mapper."""

    voxels: VoxelMap

    def tells(self, poses: Sequence[Pose], geometry: FanGeometry, voxels_m: Float64) -> Float32:
        """How much a ping from each pose is expected to tell about each voxel.

        Args:
            poses: Vehicle poses.
            geometry: The sonar.
            voxels_m: (N, 3) centres of voxels, world frame.

        Returns:
            (poses, N), from 0, nothing, to 1, all that is to be known of it.
        """


@runtime_checkable
class Mapper(Belief, Protocol):
    """Builds a map from pings and the poses the vehicle believes they were taken at.

    A mapper may keep pings, votes or whatever it needs besides ``voxels``, which must be up to date
    after every ping.
    """

    name: str

    def integrate(self, ping: Ping, pose: Pose) -> None:
        """Update the map with one ping taken at a vehicle pose."""

    def finish_scan(self) -> None:
        """Do what is left to do at the end of a scan, over the pings that were kept."""

    def save(self) -> dict[str, Array]:
        """What it needs to go on later, besides ``voxels``."""

    def load(self, arrays: Mapping[str, Array]) -> None:
        """Go on from what `save` gave, with ``voxels`` as they were then.

        Where `save` gave nothing, or there is a map alone, this is not called.
        """


@dataclass(frozen=True, slots=True)
class Shown:
    """What one ping showed of one voxel of a map.

    Attributes:
        lit: How many of its parts have an echo at their range.
        dark: How many are shown to be free.
        parts: How many parts it is looked at in: 1, or those inside it.
        log_odds: The voxel's, after the ping.
    """

    lit: int
    dark: int
    parts: int
    log_odds: float


@runtime_checkable
class Explains(Mapper, Protocol):
    """A mapper that can say, ping by ping, what made a voxel what it is."""

    def explain(self, ping: Ping, pose: Pose, voxel: tuple[int, int, int]) -> Shown:
        """Integrate a ping, with the same outcome, and tell what it showed of a voxel (its index).

        Of the voxels nothing else is asked until the last ping, so that a mapper that reads them
        off something else may wait.
        """


def check_voxels(mapper: Mapper, settings: MappingSettings) -> None:
    """Refuse a mapper whose voxels are not those of the settings, before it maps anything.

    Raises:
        ConfigError: They are of another size, or none.
    """
    if not isinstance(mapper.voxels, VoxelMap):
        raise ConfigError(f"mapper {mapper.name!r}: its voxels are no VoxelMap; see docs/own.md")
    if mapper.voxels.voxel_m != settings.voxel_m:
        raise ConfigError(
            f"mapper {mapper.name!r} has voxels of {mapper.voxels.voxel_m:g} m, and "
            f"mapping.voxel_m is {settings.voxel_m:g}; make it with the same settings"
        )
