"""How images are made: the settings that scans, simulations, tours and datasets share."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from pydantic import Field

from insonify.config.layers import named_tables, overlaid
from insonify.config.settings import Settings, Table
from insonify.scene import Scene
from insonify.scene.materials import read_materials
from insonify.scene.named import named_scene
from insonify.sonar import RendererName, Sonar, renderer_named
from insonify.sonar.devices import SonarDevice, resolved_device
from insonify.sonar.formation import ImageSettings
from insonify.sonar.physical import PhysicalSettings
from insonify.sonar.sampling import SamplingSettings
from insonify.sonar.water import WaterSettings


class Rendering(Settings):
    """How echoes become images, whatever the sonar."""

    seed: int = Field(0, ge=0, lt=2**63)
    model: Literal["cerqueira", "physical"] = Field(
        "cerqueira", description="cerqueira, or physical: the sonar equation"
    )
    renderer: RendererName = Field(RendererName.EMBREE, description="embree or opengl")
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
    physical: PhysicalSettings = PhysicalSettings()
    water: WaterSettings = WaterSettings()

    def build(self, device: SonarDevice) -> Sonar:
        """A device that makes such images.

        Raises:
            RendererError: The renderer cannot be had.
        """
        return Sonar(
            device,
            self.sampling,
            self.image,
            renderer_named(self.renderer, self.sampling),
            self.physical if self.model == "physical" else None,
            self.water,
        )


class Imaging(Rendering):
    """The same, and the sonar."""

    sonar: SonarDevice = SonarDevice()


class WorldSettings(Settings):
    """The world that is looked at."""

    world: str = Field(description="tank, grid, structures, a scenario, an SDF world, or a mesh")
    search: tuple[str, ...] = Field((), description="folders in which models are looked for")
    materials: str = Field("", description="TOML file of materials by name")

    @property
    def world_name(self) -> str:
        """The world's own name, of a file its stem."""
        return Path(self.world).stem

    def scene(self) -> Scene:
        """The world.

        Raises:
            WorldError: Its file cannot be used.
            ConfigError: There is no such name or file, or the materials cannot be used.
        """
        materials = read_materials(Path(self.materials)) if self.materials else None
        return named_scene(self.world, map(Path, self.search), materials)


class WorldImaging(WorldSettings, Imaging):
    """Images of a world with one sonar."""

    title: str = ""


def world_table(world: str, layers: Iterable[Table]) -> Table:
    """The settings of a named simulation, or of a world, with layers on top, not yet checked.

    Raises:
        ConfigError: A sonar that is named is not known.
    """
    below = named_tables("simulations").get(world, {"world": world})
    table = overlaid([{"sonar": {}}, below, *layers])
    return table | {"sonar": resolved_device(table["sonar"])}
