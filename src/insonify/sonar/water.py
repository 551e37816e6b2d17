"""Sea water as sound meets it: speed and absorption."""

from __future__ import annotations

import math
from enum import StrEnum

from pydantic import Field

from insonify.config.settings import Settings


class Absorption(StrEnum):
    """Which formula gives the absorption of sound."""

    FRANCOIS_GARRISON = "francois-garrison"
    AINSLIE_MCCOLM = "ainslie-mccolm"
    NONE = "none"


class WaterSettings(Settings):
    """The water between sonar and scene."""

    sound_speed_mps: float = Field(1500.0, ge=1300, le=1700, description="speed of sound")
    temperature_c: float = Field(10.0, ge=-2, le=40)
    salinity_psu: float = Field(35.0, ge=0, le=45)
    depth_m: float = Field(20.0, ge=0, le=11000, description="for absorption")
    ph: float = Field(8.0, ge=7, le=9)
    absorption: Absorption = Field(
        Absorption.FRANCOIS_GARRISON, description="francois-garrison, ainslie-mccolm or none"
    )

    def absorption_db_per_m(self, frequency_khz: float) -> float:
        """One-way absorption at a frequency."""
        if self.absorption is Absorption.NONE:
            return 0.0
        given = (frequency_khz, self.temperature_c, self.salinity_psu, self.depth_m, self.ph)
        if self.absorption is Absorption.FRANCOIS_GARRISON:
            return francois_garrison_db_per_km(*given) / 1000.0
        return ainslie_mccolm_db_per_km(*given) / 1000.0


def francois_garrison_db_per_km(
    frequency_khz: float, temperature_c: float, salinity_psu: float, depth_m: float, ph: float
) -> float:
    """Absorption by boric acid, magnesium sulphate and pure water.

    Source: Francois and Garrison 1982, J. Acoust. Soc. Am. 72(3) 896-907 and 72(6) 1879-1890.
    """
    f, t, s, z = frequency_khz, temperature_c, salinity_psu, depth_m
    kelvin = 273.0 + t
    c = 1412.0 + 3.21 * t + 1.19 * s + 0.0167 * z
    boric = 8.86 / c * 10.0 ** (0.78 * ph - 5.0)
    f1 = 2.8 * math.sqrt(s / 35.0) * 10.0 ** (4.0 - 1245.0 / kelvin)
    sulphate = 21.44 * s / c * (1.0 + 0.025 * t) * (1.0 - 1.37e-4 * z + 6.2e-9 * z * z)
    f2 = 8.17 * 10.0 ** (8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (s - 35.0))
    if t <= 20.0:
        viscous = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
    else:
        viscous = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
    viscous *= 1.0 - 3.83e-5 * z + 4.9e-10 * z * z
    relaxation: float = sulphate * f2 * f * f / (f2 * f2 + f * f)
    if f1 > 0.0:
        relaxation += boric * f1 * f * f / (f1 * f1 + f * f)
    return relaxation + viscous * f * f


def ainslie_mccolm_db_per_km(
    frequency_khz: float, temperature_c: float, salinity_psu: float, depth_m: float, ph: float
) -> float:
    """A simpler formula for the same, within 10 % of it in sea water from 100 Hz to 1 MHz.

    Source: Ainslie and McColm 1998, J. Acoust. Soc. Am. 103(3) 1671-1672.
    """
    f, t, s, z_km = frequency_khz, temperature_c, salinity_psu, depth_m / 1000.0
    f1 = 0.78 * math.sqrt(s / 35.0) * math.exp(t / 26.0)
    f2 = 42.0 * math.exp(t / 17.0)
    boric = 0.106 * f1 * f * f / (f1 * f1 + f * f) * math.exp((ph - 8.0) / 0.56)
    sulphate = 0.52 * (1.0 + t / 43.0) * (s / 35.0) * f2 * f * f / (f2 * f2 + f * f)
    viscous = 0.00049 * f * f * math.exp(-(t / 27.0 + z_km / 17.0))
    return boric + sulphate * math.exp(-z_km / 6.0) + viscous
