"""Imaging sonar: devices, renderers, image formation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from insonify.scene import Scene
from insonify.sonar.devices import SonarDevice
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.formation import ImageSettings, form_image
from insonify.sonar.histogram import Law, Renderer, Response
from insonify.sonar.physical import PhysicalSettings, SpeckleField, form_physical
from insonify.sonar.sampling import SamplingSettings
from insonify.sonar.water import WaterSettings
from insonify.types import Ping, Pose


@dataclass(frozen=True, slots=True)
class Sonar:
    """A simulated sonar.

    Args:
        device: What is mounted on the vehicle.
        sampling: How finely its beams are sampled, where no renderer is given.
        image: How echoes become an image.
        renderer: What samples the beams; by default Embree's rays.
        physical: The sonar equation instead of ``image``, if it is given.
        water: What ``physical`` needs to know of the water.
        speckle: The speckle of ``physical``, which changes from ping to ping as the sonar moves.
    """

    device: SonarDevice = SonarDevice()
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
    renderer: Renderer | None = None
    physical: PhysicalSettings | None = None
    water: WaterSettings = WaterSettings()
    speckle: SpeckleField = field(default_factory=SpeckleField, compare=False)

    def ping(self, scene: Scene, pose: Pose, rng: np.random.Generator) -> Ping:
        """One image of a scene from a vehicle pose; the noise is drawn from ``rng``."""
        geometry = self.device.geometry
        renderer = self.renderer or EmbreeRenderer(self.sampling)
        if self.physical is not None:
            lambert = Response(Law.LAMBERT, edge_db=self.physical.edge_db)
            echoes = renderer.render(scene, geometry, pose, lambert)
            image = form_physical(
                echoes, geometry, self.device.frequency_khz, self.physical, self.water,
                self.speckle, pose, rng,
            )  # fmt: skip
            return Ping(image, geometry)
        response = Response(Law.SIGMOID, self.image.sigmoid_slope, self.image.sigmoid_centre)
        echoes = renderer.render(scene, geometry, pose, response)
        return Ping(form_image(echoes, self.image, rng), geometry)
