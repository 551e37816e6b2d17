"""Imaging sonar: devices, renderers, image formation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from insonify.scene import Scene
from insonify.sonar.devices import SonarDevice
from insonify.sonar.draws import drawn_key
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.formation import ImageSettings, form_image
from insonify.sonar.histogram import EchoHistogram, Law, Renderer, Response
from insonify.sonar.opengl import OpenGLRenderer
from insonify.sonar.physical import PhysicalSettings, Receiver, Speckle, form_physical
from insonify.sonar.sampling import SamplingSettings
from insonify.sonar.speckle import SpeckleField
from insonify.sonar.truth import Truth, find_truth
from insonify.sonar.water import WaterSettings
from insonify.types import FanGeometry, Float32, Ping, Pose


class RendererName(StrEnum):
    """The renderers."""

    EMBREE = "embree"
    OPENGL = "opengl"


def renderer_named(name: RendererName, sampling: SamplingSettings) -> Renderer:
    """A renderer.

    Raises:
        RendererError: It cannot be had here.
    """
    if name is RendererName.OPENGL:
        return OpenGLRenderer(sampling)
    return EmbreeRenderer(sampling)


@dataclass(slots=True)
class Sonar:
    """A simulated sonar.

    Its settings do not change.  With ``physical``, its state does: ``speckle`` moves on with every
    ping, so that a sonar that stays where it is sees the same speckle again.

    Args:
        device: What is mounted on the vehicle.
        sampling: How finely its beams are sampled, where no renderer is given.
        image: How echoes become an image.
        renderer: What samples the beams; by default Embree's rays.
        physical: The sonar equation instead of ``image``, if it is given.
        water: What ``physical`` needs to know of the water.
        speckle: The state.
    """

    device: SonarDevice = SonarDevice()
    sampling: SamplingSettings = SamplingSettings()
    image: ImageSettings = ImageSettings()
    renderer: Renderer | None = None
    physical: PhysicalSettings | None = None
    water: WaterSettings = WaterSettings()
    speckle: SpeckleField = field(default_factory=SpeckleField, compare=False)

    def ping(
        self,
        scene: Scene,
        pose: Pose,
        rng: np.random.Generator | None = None,
        *,
        head_rad: float = 0.0,
        time_s: float = 0.0,
    ) -> Ping:
        """One image of a scene from a vehicle pose.

        Args:
            scene: What is there.
            pose: Where the vehicle is.
            rng: Where the noise comes from; without it every ping draws the same, of seed 0.
            head_rad: How far to the left the head of a scanning sonar is turned.
            time_s: When the sound is sent.
        """
        key = drawn_key(rng or np.random.default_rng(0))
        geometry = self.device.geometry_at(head_rad)
        echoes = self._renderer.render(scene, geometry, pose, self.response)
        return Ping(self._form(echoes, geometry, pose, key), geometry, time_s, head_rad)

    def skip(self, pose: Pose, rng: np.random.Generator) -> None:
        """Let its state and ``rng`` move on as if it had pinged from a pose."""
        key = drawn_key(rng)
        if self.physical is not None and self.physical.speckle is not Speckle.NONE:
            self._form(_nothing(self.device), self.device.geometry, pose, key)

    def ambient(self) -> Float32:
        """What it shows where there is nothing but water, (bins, beams): noise, and the water."""
        alone = replace(self, speckle=SpeckleField())
        return alone._form(_nothing(self.device), self.device.geometry, Pose(0.0, 0.0, 0.0), 0)

    def _form(self, echoes: EchoHistogram, geometry: FanGeometry, pose: Pose, key: int) -> Float32:
        if self.physical is None:
            return form_image(echoes, self.image, key)
        receiver = Receiver(self.device, self.physical, self.water)
        return form_physical(echoes, geometry, receiver, self.speckle, pose, key)

    def truth(self, scene: Scene, pose: Pose, *, head_rad: float = 0.0) -> Truth:
        """What each pixel of the image from a pose shows, as far as its echoes come straight."""
        geometry = self.device.geometry_at(head_rad)
        direct = replace(self.response, second_bounce=False, surface_mirror=False)
        samples = self._renderer.sample(scene, geometry, pose, direct)
        return find_truth(samples, scene, geometry, pose)

    @property
    def response(self) -> Response:
        """How surfaces echo in this sonar's model."""
        if self.physical is None:
            return Response(Law.SIGMOID, self.image.sigmoid_slope, self.image.sigmoid_centre)
        return Response(
            Law.LAMBERT,
            edge_db=self.physical.edge_db,
            second_bounce=self.physical.second_bounce,
            surface_mirror=self.physical.surface_mirror,
        )

    @property
    def _renderer(self) -> Renderer:
        return self.renderer or EmbreeRenderer(self.sampling)


def _nothing(device: SonarDevice) -> EchoHistogram:
    nothing = np.zeros((device.bins, device.beams), np.float32)
    return EchoHistogram(nothing, nothing)
