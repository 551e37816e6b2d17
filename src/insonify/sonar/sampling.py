"""How finely the beams are sampled: chosen from range bins and geometry, unless it is said."""

from __future__ import annotations

import math
import warnings

from pydantic import Field

from insonify.config.settings import Settings
from insonify.types import FanGeometry

_BINS_HIGH, _BINS_WIDE = 5.0, 24.0
"""Arc of a patch at the farthest range, in bins; its echo is shared among those it spans."""
_FEWEST_OVER, _MOST_OVER, _FEWEST_ACROSS, _MOST_ACROSS = 64, 1024, 8, 16


class UndersamplingWarning(UserWarning):
    """The sampling asked for is coarser than the device's range bins can bear."""


class SamplingSettings(Settings):
    """How finely the beams are sampled."""

    across_beam: int = Field(
        0, ge=0, le=512, description="samples across a beam's azimuth; 0: chosen from the bins"
    )
    over_elevation: int = Field(
        0, ge=0, le=16384, description="samples over the elevation; 0: chosen from the bins"
    )
    refine: int = Field(
        5, ge=1, le=32, description="samples at edges are divided so often each way; 1: never"
    )


def even_samples(geometry: FanGeometry, settings: SamplingSettings) -> tuple[int, int]:
    """Samples across each beam and over its elevation, before edges are refined.

    Warns:
        UndersamplingWarning: A number was asked for that makes patches four times too large.
    """
    farthest_bins = geometry.range_max_m / geometry.bin_m
    over = math.ceil(geometry.elevation_fov_rad * farthest_bins / _BINS_HIGH)
    over = min(max(over, _FEWEST_OVER), _MOST_OVER)
    across = math.ceil(geometry.beam_rad * farthest_bins / _BINS_WIDE)
    across = min(max(across, math.ceil(_FEWEST_ACROSS / geometry.beams)), _MOST_ACROSS)
    for asked, chosen, where in (
        (settings.across_beam, across, "across_beam"),
        (settings.over_elevation, over, "over_elevation"),
    ):
        if 0 < asked * 4 < chosen:
            warnings.warn(
                f"sampling.{where}={asked} is too coarse for bins of {geometry.bin_m:g} m at "
                f"{geometry.range_max_m:g} m; {chosen} would do (0 chooses)",
                UndersamplingWarning,
                stacklevel=3,
            )
    return settings.across_beam or across, settings.over_elevation or over
