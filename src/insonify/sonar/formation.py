"""From echoes to an image: energy normalisation, speckle, receiver noise, as Cerqueira et al. 2017.

Every stage takes and returns ``(bins, beams) float32`` in [0, 1].
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.sonar.histogram import FULL_CELL, EchoHistogram
from insonify.types import Float32


class ImageSettings(Settings):
    """How echoes become an image."""

    sigmoid_slope: float = Field(6.0, gt=0, le=1000, description="slope of S in eq. 1")
    sigmoid_centre: float = Field(0.3, ge=0, le=1, description="intensity at which S is 0.5")
    speckle: float = Field(
        0.2, ge=0, le=1, description="standard deviation of the multiplicative speckle, eq. 2"
    )
    speckle_skew: float = Field(
        0.9, ge=0, lt=1, description="0: Gaussian; towards 1: most values low, a tail high"
    )
    noise: float = Field(0.02, ge=0, le=1, description="standard deviation of additive noise")


def form_image(echoes: EchoHistogram, settings: ImageSettings, rng: np.random.Generator) -> Float32:
    """The sonar image of an echo histogram: eq. 1, then eq. 2, then additive noise.

    Args:
        echoes: What a renderer saw.
        settings: Which noise, how strong.
        rng: Where the noise comes from.
    """
    image = normalise_energy(echoes)
    if settings.speckle > 0.0:
        image *= speckle(image.shape, settings.speckle, settings.speckle_skew, rng)
    if settings.noise > 0.0:
        image += rng.standard_normal(image.shape, dtype=np.float32) * np.float32(settings.noise)
    return np.clip(image, 0.0, 1.0, out=image)


def normalise_energy(echoes: EchoHistogram) -> Float32:
    """Mean echo of the samples in each cell, 0 where there is none (eq. 1).

    A cell that holds next to nothing, less than ``FULL_CELL`` of an even share of its beam, fades
    with it.  Otherwise an outline's brightness would hang on whether one sample more just touches
    a cell, and no number of samples would settle it.
    """
    least = np.float32(FULL_CELL / echoes.coverage.shape[0])
    return (echoes.echo / np.maximum(echoes.coverage, least)).astype(np.float32)


def speckle(
    shape: tuple[int, ...], spread: float, skew: float, rng: np.random.Generator
) -> Float32:
    """Multiplicative noise n(t) of eq. 2: a skew-normal of mean 1, cut at 0.

    The paper's Gaussian is "skewed towards low values" without saying how; this is Azzalini's
    skew-normal with ``delta = skew``, shifted to mean 1 and scaled to the standard deviation
    ``spread``.
    """
    noise = rng.standard_normal(shape, dtype=np.float32)
    noise *= np.float32(math.sqrt(1.0 - skew * skew))
    half = rng.standard_normal(shape, dtype=np.float32)
    noise += np.abs(half, out=half) * np.float32(skew)
    mean = skew * math.sqrt(2.0 / math.pi)
    deviation = math.sqrt(1.0 - mean * mean)
    noise -= np.float32(mean)
    noise *= np.float32(spread / deviation)
    noise += np.float32(1.0)
    return np.maximum(noise, 0.0, out=noise)
