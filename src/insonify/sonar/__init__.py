"""Imaging sonar: devices, renderers, image formation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import islice

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

_LOBES, _HIGHEST_RAD = 3.0, math.radians(120.0)
"""Side lobes are heard to so many times a beam's height, and no higher than this in all."""
_PIXELS_TOGETHER = 2**14
"""Pings of so many pixels in all are rendered in one call; a ping of more, alone."""


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
        return next(self.pings(scene, [pose], rng, heads_rad=[head_rad], times_s=[time_s]))

    def pings(
        self,
        scene: Scene,
        poses: Iterable[Pose],
        rng: np.random.Generator | None = None,
        *,
        heads_rad: Iterable[float] | None = None,
        times_s: Iterable[float] | None = None,
    ) -> Iterator[Ping]:
        """Images from many poses, as they are asked for: the same as `ping` gives one by one.

        Where a ping has few rays, those of several are cast in one call, several times as fast.

        Args:
            scene: What is there.
            poses: Where the vehicle is at each ping.
            rng: Where the noise comes from; without it every ping draws the same, of seed 0.
            heads_rad: How far to the left the head of a scanning sonar is turned at each; 0.
            times_s: When each one's sound is sent; 0.

        Raises:
            ValueError: There are more or fewer angles or times than poses.
        """
        poses = list(poses)
        heads_rad = [0.0] * len(poses) if heads_rad is None else heads_rad
        times_s = [0.0] * len(poses) if times_s is None else times_s
        together = max(1, _PIXELS_TOGETHER // (self.device.beams * self.device.bins))
        moments = zip(poses, heads_rad, times_s, strict=True)
        while several := list(islice(moments, together)):
            places = [pose for pose, _, _ in several]
            fans = [self.device.geometry_at(head_rad) for _, head_rad, _ in several]
            keys = [drawn_key(rng or np.random.default_rng(0)) for _ in several]
            heard = [self._heard(fan) for fan in fans]
            images = self._images(scene, heard, places, keys)
            for (_, head_rad, time_s), fan, image in zip(several, fans, images, strict=True):
                yield Ping(image, fan, time_s, head_rad)

    def skip(self, pose: Pose, rng: np.random.Generator) -> None:
        """Let its state and ``rng`` move on as if it had pinged from a pose."""
        key = drawn_key(rng)
        if self.physical is not None and self.physical.speckle is not Speckle.NONE:
            self._form(_nothing(self.device), self.device.geometry, pose, key)

    def ambient(self) -> Float32:
        """What it shows where there is nothing but water, (bins, beams): noise, and the water."""
        alone = replace(self, speckle=SpeckleField())
        return alone._form(_nothing(self.device), self.device.geometry, Pose(0.0, 0.0, 0.0), 0)

    def _images(
        self, scene: Scene, fans: list[FanGeometry], poses: list[Pose], keys: list[int]
    ) -> list[Float32]:
        """Render and form; the paper's images where the echoes are, if that is a device."""
        renderer = self._renderer
        if isinstance(renderer, OpenGLRenderer) and self.physical is None:
            each = zip(fans, poses, keys, strict=True)
            return [
                renderer.image(scene, fan, pose, self.response, self.image, key)
                for fan, pose, key in each
            ]
        echoes = renderer.render_all(scene, fans, poses, self.response)
        return self._form_all(echoes, fans, poses, keys)

    @property
    def _edge_rad(self) -> float:
        """Elevation of the beam's upper edge."""
        return math.radians(self.device.elevation_fov_deg) / 2

    def _heard(self, fan: FanGeometry) -> FanGeometry:
        """The fan as far up and down as it is heard: where it is looked for echoes."""
        if self.physical is None or not self.physical.elevation_lobes:
            return fan
        height_rad = min(_LOBES * fan.elevation_fov_rad, _HIGHEST_RAD)
        return replace(fan, elevation_fov_rad=max(height_rad, fan.elevation_fov_rad))

    def _form_all(
        self, echoes: EchoHistogram, fans: list[FanGeometry], poses: list[Pose], keys: list[int]
    ) -> list[Float32]:
        """The images of pings whose echoes lie side by side."""
        parts = [
            slice(k * self.device.beams, (k + 1) * self.device.beams) for k in range(len(fans))
        ]
        if self.physical is None:
            images = form_image(echoes, self.image, *keys)
            return [images[:, part] for part in parts]
        own = [EchoHistogram(echoes.echo[:, one], echoes.coverage[:, one]) for one in parts]
        return [self._form(*each) for each in zip(own, fans, poses, keys, strict=True)]

    def _form(self, echoes: EchoHistogram, geometry: FanGeometry, pose: Pose, key: int) -> Float32:
        if self.physical is None:
            return form_image(echoes, self.image, key)
        receiver = Receiver(self.device, self.physical, self.water)
        return form_physical(echoes, geometry, receiver, self.speckle, pose, key)

    def truth(self, scene: Scene, pose: Pose, *, head_rad: float = 0.0) -> Truth:
        """What each pixel of the image from a pose shows, as far as its echoes come straight."""
        geometry = self.device.geometry_at(head_rad)
        direct = replace(
            self.response,
            lobes_edge_rad=0.0,
            surface=0.0,
            second_bounce=False,
            surface_mirror=False,
        )
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
            lobes_edge_rad=self._edge_rad if self.physical.elevation_lobes else 0.0,
            surface=self.physical.surface,
            second_bounce=self.physical.second_bounce,
            surface_mirror=self.physical.surface_mirror,
        )

    @property
    def _renderer(self) -> Renderer:
        return self.renderer or EmbreeRenderer(self.sampling)


def _nothing(device: SonarDevice) -> EchoHistogram:
    nothing = np.zeros((device.bins, device.beams), np.float32)
    return EchoHistogram(nothing, nothing)
