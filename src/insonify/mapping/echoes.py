"""What of a sonar's images is an echo: the noise, told from the images themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from insonify.types import Float32

_QUIET = 0.25
"""Share of the ranges that are taken as noise: the quietest."""
_SPREADS = 4.5
"""Above the median; fewer than one pixel of a million of Gaussian or Rayleigh noise is more."""
_LEAST = 1.5 / 255.0


def noise_threshold(images: Sequence[Float32]) -> float:
    """The pixel value, of 1, that a recording's noise does not reach.

    Taken from the quietest quarter of the ranges over all images: the median of their pixels, and
    4.5 times as far above it as nine tenths of them reach; never less than 1.5 steps of 8 bits.

    Args:
        images: (bins, beams) each, of one number of bins.
    """
    loud = np.quantile(np.concatenate(images, axis=1), 0.9, axis=1)
    quiet = np.argsort(loud, kind="stable")[: max(1, round(_QUIET * len(loud)))]
    return _above(np.concatenate([image[quiet].ravel() for image in images]))


def ambient_threshold(image: Float32) -> float:
    """The pixel value, of 1, that noise does not reach where it is loudest.

    Args:
        image: (bins, beams) of a sonar in empty water.
    """
    loud = np.quantile(image, 0.9, axis=1)
    loudest = np.argsort(loud, kind="stable")[-max(1, round(_QUIET * len(loud))) :]
    return _above(image[loudest].ravel())


def _above(noise: Float32) -> float:
    middle, most = (float(value) for value in np.quantile(noise, [0.5, 0.9]))
    return min(1.0, max(_LEAST, middle + _SPREADS * (most - middle)))
