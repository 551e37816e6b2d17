"""Imaging sonar: devices, renderers, image formation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from insonify.scene import Scene
from insonify.sonar.devices import SonarDevice
from insonify.sonar.embree import EmbreeRenderer, Response
from insonify.sonar.formation import ImageSettings, form_image
from insonify.types import Ping, Pose


class SamplingSettings(BaseModel):
    """How finely rays sample the beams."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rays_per_beam: int = Field(2, ge=1, le=64, description="rays across a beam's azimuth")
    rays_in_elevation: int = Field(96, ge=2, le=8192, description="rays over the elevation")


@dataclass(frozen=True, slots=True)
class Sonar:
    """A simulated sonar.

    Args:
        device: What is mounted on the vehicle.
        sampling: How finely its beams are sampled.
        image: How echoes become an image.
    """

    device: SonarDevice = SonarDevice()
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()

    def ping(self, scene: Scene, pose: Pose, rng: np.random.Generator) -> Ping:
        """One image of a scene from a vehicle pose; the noise is drawn from ``rng``."""
        geometry = self.device.geometry
        renderer = EmbreeRenderer(
            self.sampling.rays_per_beam,
            self.sampling.rays_in_elevation,
            Response(self.image.sigmoid_slope, self.image.sigmoid_centre),
        )
        echoes = renderer.render(scene, geometry, pose)
        return Ping(form_image(echoes, self.image, rng), geometry)
