"""Imaging sonar: devices, renderers, image formation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from insonify.scene import Scene
from insonify.sonar.devices import SonarDevice
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.formation import ImageSettings, form_image
from insonify.sonar.histogram import Law, Renderer, Response
from insonify.sonar.sampling import SamplingSettings
from insonify.types import Ping, Pose


@dataclass(frozen=True, slots=True)
class Sonar:
    """A simulated sonar.

    Args:
        device: What is mounted on the vehicle.
        sampling: How finely its beams are sampled, where no renderer is given.
        image: How echoes become an image.
        renderer: What samples the beams; by default Embree's rays.
    """

    device: SonarDevice = SonarDevice()
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
    renderer: Renderer | None = None

    def ping(self, scene: Scene, pose: Pose, rng: np.random.Generator) -> Ping:
        """One image of a scene from a vehicle pose; the noise is drawn from ``rng``."""
        geometry = self.device.geometry
        renderer = self.renderer or EmbreeRenderer(self.sampling)
        response = Response(Law.SIGMOID, self.image.sigmoid_slope, self.image.sigmoid_centre)
        echoes = renderer.render(scene, geometry, pose, response)
        return Ping(form_image(echoes, self.image, rng), geometry)
