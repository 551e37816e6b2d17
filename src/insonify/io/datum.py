"""Where a map lies on the Earth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pymap3d

from insonify.errors import GeometryError
from insonify.types import Pose


@dataclass(frozen=True, slots=True)
class Datum:
    """Where the map's origin lies on WGS 84.

    Raises:
        GeometryError: It lies nowhere.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        values = (self.latitude_deg, self.longitude_deg, self.height_m)
        if not (
            all(map(math.isfinite, values))
            and abs(self.latitude_deg) <= 90.0
            and abs(self.longitude_deg) <= 180.0
            and abs(self.height_m) < 20_000.0
        ):
            raise GeometryError(
                f"a datum is latitude, longitude (deg) and height (m), not {values}"
            )

    def geodetic(self, pose: Pose) -> tuple[float, float, float]:
        """Latitude and longitude in degrees and height in metres of a pose of the map."""
        origin = (self.latitude_deg, self.longitude_deg, self.height_m)
        latitude, longitude, height = pymap3d.enu2geodetic(*pose.position_m, *origin)
        return float(latitude), float(longitude), float(height)
