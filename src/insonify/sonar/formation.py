"""From echoes to an image as Cerqueira et al. 2017: normalisation, speckle, receiver noise."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.jit import parallel_kernel, prange
from insonify.sonar.draws import draw_row, normal_table, skew_normal_table, variate
from insonify.sonar.histogram import FULL_CELL, EchoHistogram
from insonify.types import Float32, UInt64


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


def form_image(echoes: EchoHistogram, settings: ImageSettings, *keys: int) -> Float32:
    """The sonar image of an echo histogram: eq. 1, then eq. 2, then additive noise.

    Those of several pings lie side by side, as their echoes do.

    The paper's Gaussian speckle n(t) of eq. 2 is "skewed towards low values" without saying how;
    this is Azzalini's skew-normal with ``delta = speckle_skew``, shifted to mean 1, scaled to the
    standard deviation ``speckle`` and cut at 0.

    Args:
        echoes: What a renderer saw.
        settings: Which noise, how strong.
        keys: One a ping, 64 bits; the same key draws the same noise (`sonar.draws`).
    """
    echo, coverage = np.ascontiguousarray(echoes.echo.T), np.ascontiguousarray(echoes.coverage.T)
    image = np.empty_like(echo)
    _form(
        echo, coverage, FULL_CELL / echo.shape[1], np.array(keys, np.uint64),
        skew_normal_table(settings.speckle, settings.speckle_skew), normal_table(),
        settings.noise, image,
    )  # fmt: skip
    return image.T


def normalise_energy(echoes: EchoHistogram) -> Float32:
    """Mean echo of the samples in each cell, 0 where there is none (eq. 1): no noise yet.

    A cell that holds next to nothing, less than ``FULL_CELL`` of an even share of its beam, fades
    with it.  Otherwise an outline's brightness would hang on whether one sample more just touches
    a cell, and no number of samples would settle it.
    """
    least = np.float32(FULL_CELL / echoes.coverage.shape[0])
    return (echoes.echo / np.maximum(echoes.coverage, least)).astype(np.float32)


@parallel_kernel
def _form(
    echo: Float32,
    coverage: Float32,
    least: float,
    keys: UInt64,
    speckle: Float32,
    normal: Float32,
    noise: float,
    image: Float32,
) -> None:
    """Normalise (pings x beams, bins), multiply, add and clip; two bins share a counter."""
    rows, bins = echo.shape
    beams = rows // len(keys)
    for row in prange(rows):
        drawn = np.empty((4, (bins + 1) // 2), np.uint32)
        draw_row(keys[row // beams], row % beams, 0, drawn)
        for cell in range(bins):
            own = 2 * (cell % 2)
            value = echo[row, cell] / max(coverage[row, cell], np.float32(least))
            value = value * variate(speckle, drawn[own, cell // 2])
            value += np.float32(noise) * variate(normal, drawn[own + 1, cell // 2])
            image[row, cell] = min(max(value, np.float32(0.0)), np.float32(1.0))
