"""From echoes to an image by the sonar equation, in dB re 1 uPa; nothing depends on the frame.

The echo of a cell is the backscatter of the surface in it, per solid angle.  A patch of a surface
with Lambert's coefficient mu, seen at an angle of incidence a over a solid angle dW, scatters back
``mu cos^2 a`` times its area ``r^2 dW / cos a``; so the level received is

    RL = SL - 2 TL + 10 log10(r^2 sum(mu cos a dW)),  TL = 20 log10 r + alpha r

(Urick, Principles of Underwater Sound, 1983, chapters 2 and 8).  The pressure of a cell is a
complex number: of the scatterers in it, on surfaces and in the water, times speckle, and of the
receiver's noise.  A beam hears in a bin the sum of its neighbours' pressures, weighted by the
array's pattern and the pulse's shape: a bright target streaks, and speckle is as large as a
resolution cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.jit import kernel, parallel_kernel, prange
from insonify.scene.materials import material_named
from insonify.sonar.devices import LEAST_REACH_M, SonarDevice
from insonify.sonar.draws import draw_row, gamma_table, normal_table, variate
from insonify.sonar.histogram import EchoHistogram
from insonify.sonar.pattern import heard_by_all, leakage
from insonify.sonar.speckle import SpeckleField
from insonify.sonar.water import WaterSettings
from insonify.types import FanGeometry, Float32, Float64, Pose

_OCTAVE_DB = np.float32(10.0 * math.log10(2.0))
_NEPER_DB = np.float32(10.0 / math.log(10.0))
_MIDDLE_DB = np.float32(10.0 * math.log10(1.5))
_LN2 = np.float32(math.log(2.0))

FAR, HIGH, SAND = 0.7, 0.1, "sand"
"""A receiver is told by what it hears of sand at this share of its reach, from this share above."""


class Speckle(StrEnum):
    """How the echoes of many scatterers in a cell add up."""

    RAYLEIGH = "rayleigh"
    K = "k"
    NONE = "none"


class PhysicalSettings(Settings):
    """The stages of the physical model.

    No maker publishes source levels or noise.  They say how far a device reaches, so its noise is
    taken to be ``snr_db`` below the echo of level sand at 70 % of its reach, seen from a tenth of
    its reach above.
    """

    source_level_db: float = Field(200.0, ge=0, le=260, description="SL, dB re 1 uPa at 1 m")
    noise: bool = Field(True, description="receiver noise, up to which the gain is raised")
    snr_db: float = Field(
        10.0, ge=-40, le=100, description="of sand at 70 % of the reach, over receiver noise"
    )
    volume_db: float = Field(
        -70.0, ge=-200, le=0, description="of the water at 1 MHz, dB re 1/m; as f^4; -200: none"
    )
    edge_db: float = Field(
        3.0, ge=0, le=40, description="one-way loss at the beam's upper and lower edge"
    )
    elevation_lobes: bool = Field(
        False, description="side lobes above and below the beam too, to three times its height"
    )
    taper: float = Field(
        0.85, ge=0, le=1, description="of the array: 0 uniform, side lobes -13 dB; 0.85 Hamming"
    )
    side_lobes: bool = Field(True, description="beams hear echoes beside their own")
    pulse: bool = Field(True, description="echoes spread over the device's range resolution")
    ripple_db: float = Field(0.0, ge=0, le=20, description="how unlike the beams' gains are (rms)")
    speckle: Speckle = Field(Speckle.RAYLEIGH, description="rayleigh, k or none")
    k_shape: float = Field(2.0, gt=0, le=1000, description="nu of the K distribution's texture")
    tvg_spreading: float = Field(
        30.0, ge=0, le=80, description="time-varying gain of so much log10 r, dB"
    )
    tvg_absorption: bool = Field(True, description="and of 2 alpha r; both to 70 % of the reach")
    surface_db: float = Field(
        -200.0,
        ge=-200,
        le=0,
        description="of the water's surface from below, Lambert's law; -200: none (Embree only)",
    )
    second_bounce: bool = Field(
        False, description="echoes by way of a second surface, which mirrors (Embree only)"
    )
    surface_mirror: bool = Field(
        False, description="echoes by way of the water's surface at z = 0 (Embree only)"
    )

    @property
    def surface(self) -> float:
        """Lambert's coefficient of the water's surface, seen from below."""
        return 0.0 if self.surface_db <= -200.0 else float(10.0 ** (self.surface_db / 10.0))


@dataclass(frozen=True, slots=True)
class Receiver:
    """What the sonar equation needs to know.

    Attributes:
        device: The sonar: its frequency, beamwidth, resolution, reach and display.
        settings: Which stages, how strong.
        water: Absorption and speed of sound.
    """

    device: SonarDevice
    settings: PhysicalSettings = PhysicalSettings()
    water: WaterSettings = WaterSettings()

    def beam_rad(self, geometry: FanGeometry) -> float:
        """Its beams' width; as wide as they are apart where the device does not say."""
        return math.radians(self.device.beamwidth_deg) or geometry.beam_rad

    @property
    def far_m(self) -> float:
        """Where sand is ``snr_db`` over noise, and the gain stops to rise."""
        return FAR * max(self.device.reach_m or self.device.range_max_m, LEAST_REACH_M)

    @property
    def volume(self) -> float:
        """Backscatter of the water, per m: of particles smaller than the wavelength (Rayleigh)."""
        if self.settings.volume_db <= -200.0:
            return 0.0
        megahertz = self.device.frequency_khz / 1000.0
        return float(10.0 ** (self.settings.volume_db / 10.0) * megahertz**4)

    def level(self, geometry: FanGeometry) -> Float32:
        """Power of an echo of strength 1 in each bin, (bins,), re 1 uPa^2."""
        range_m = np.maximum(geometry.bin_ranges_m, geometry.bin_m / 2)
        solid_angle = geometry.beam_rad * geometry.elevation_fov_rad
        level = 10.0 ** (self._lost_db(range_m, self.water) / 10.0) * solid_angle
        return level.astype(np.float32)

    def sand_db(self, geometry: FanGeometry) -> float:
        """Level of level sand at `far_m`, in the water that settings have by default."""
        far_m, height_m = self.far_m, HIGH / FAR * self.far_m
        grazing = height_m / far_m
        elevation_rad = height_m * geometry.bin_m / far_m**2
        sand = material_named(SAND)
        assert sand is not None
        mu = 10.0 ** (sand.lambert_db / 10.0)
        echo = mu * grazing * elevation_rad * geometry.beam_rad
        lost_db = self._lost_db(np.array([far_m]), WaterSettings())[0]
        return float(lost_db + 10.0 * math.log10(echo))

    def noise_db(self, geometry: FanGeometry) -> float:
        """Level of the receiver's noise, dB re 1 uPa."""
        return self.sand_db(geometry) - self.settings.snr_db

    def gain_db(self, geometry: FanGeometry) -> Float32:
        """Time-varying gain in each bin, (bins,)."""
        return self._gain_db(np.maximum(geometry.bin_ranges_m, geometry.bin_m / 2))

    def full_db(self, geometry: FanGeometry) -> float:
        """Level that is shown as 1, after the gain."""
        return (
            self.sand_db(geometry)
            + float(self._gain_db(np.array([self.far_m]))[0])
            + self.device.headroom_db
        )

    def pulse_taps(self, geometry: FanGeometry) -> Float32:
        """The pulse's pressure by bins around its middle, an odd number, squares adding up to 1.

        It is Gaussian, half its power where the range resolution ends.
        """
        if not self.settings.pulse:
            return np.ones(1, np.float32)
        width = max(self.device.range_resolution_m / geometry.bin_m, 1.0)
        reach = math.ceil(1.5 * width)
        taps = np.exp2(-2.0 * (np.arange(-reach, reach + 1) / width) ** 2)
        return (taps / math.sqrt(float((taps**2).sum()))).astype(np.float32)

    def _lost_db(self, range_m: Float64, water: WaterSettings) -> Float64:
        """Source level less spreading and absorption, both ways, of a solid angle's echo."""
        alpha = water.absorption_db_per_m(self.device.frequency_khz)
        lost: Float64 = 20.0 * np.log10(range_m) + 2.0 * alpha * range_m
        return self.settings.source_level_db - lost

    def _gain_db(self, range_m: Float64) -> Float32:
        range_m = np.minimum(range_m, self.far_m)
        gain_db = self.settings.tvg_spreading * np.log10(range_m)
        if self.settings.tvg_absorption:
            alpha = self.water.absorption_db_per_m(self.device.frequency_khz)
            gain_db = gain_db + 2.0 * alpha * range_m
        return gain_db.astype(np.float32)


def form_physical(
    echoes: EchoHistogram,
    geometry: FanGeometry,
    receiver: Receiver,
    speckle: SpeckleField,
    pose: Pose,
    key: int,
) -> Float32:
    """The image of an echo histogram rendered with Lambert's law, (bins, beams) in [0, 1].

    Args:
        echoes: What a renderer saw.
        geometry: Of the sonar.
        receiver: What hears them.
        speckle: The sonar's speckle; it moves on to this ping.
        pose: Where the sonar is.
        key: Of the ping, 64 bits; the same key draws the same noise (`sonar.draws`).
    """
    settings = receiver.settings
    beams, bins = geometry.beams, geometry.bins
    beam_rad = receiver.beam_rad(geometry)
    wavelength_m = receiver.water.sound_speed_mps / (1000.0 * receiver.device.frequency_khz)
    kept = speckle.move((beams, bins), pose, beam_rad, wavelength_m)
    power = _scattered(
        np.ascontiguousarray(echoes.echo.T), np.ascontiguousarray(echoes.coverage.T),
        receiver.level(geometry), receiver.volume * geometry.bin_m,
    )  # fmt: skip
    noise = 10.0 ** (receiver.noise_db(geometry) / 20.0) if settings.noise else 0.0
    k_speckle = settings.speckle is Speckle.K
    pressure = np.empty((beams, 2, bins), np.float32)
    _pressure(
        power, speckle.amplitude, speckle.texture, kept,
        settings.speckle is not Speckle.NONE, k_speckle,
        gamma_table(settings.k_shape if k_speckle else 1.0), normal_table(), noise,
        np.uint64(key), pressure,
    )  # fmt: skip
    steady = power if settings.speckle is Speckle.NONE else np.zeros((beams, 0), np.float32)
    if settings.side_lobes and beams > 1:
        heard = leakage(beams, geometry.beam_rad, beam_rad, settings.taper)
        pressure = heard_by_all(heard, pressure.reshape(beams, 2 * bins)).reshape(beams, 2, bins)
        steady = heard_by_all(heard**2, steady)
    ripple_db = settings.ripple_db * np.random.default_rng(0).standard_normal(beams)
    image = np.empty((beams, bins), np.float32)
    _show(
        pressure, steady, receiver.pulse_taps(geometry),
        receiver.gain_db(geometry) - np.float32(receiver.full_db(geometry)),
        ripple_db.astype(np.float32), receiver.device.display_gamma, image,
    )  # fmt: skip
    return image.T


@parallel_kernel
def _scattered(echo: Float32, coverage: Float32, level: Float32, water: float) -> Float32:
    """Power scattered back from surfaces and from the water before them, (beams, bins)."""
    beams, bins = echo.shape
    power = np.empty_like(echo)
    for beam in prange(beams):
        clear = np.float32(1.0)
        for cell in range(bins):
            power[beam, cell] = level[cell] * (echo[beam, cell] + np.float32(water) * clear)
            clear = max(clear - coverage[beam, cell], np.float32(0.0))
    return power


@parallel_kernel
def _pressure(
    power: Float32,
    amplitude: Float32,
    texture: Float32,
    kept: float,
    speckled: bool,
    textured: bool,
    gamma: Float32,
    normal: Float32,
    noise: float,
    key: np.uint64,
    pressure: Float32,
) -> None:
    """Move the speckle on, and write the complex pressure (beams, 2, bins) with its noise."""
    half = np.float32(math.sqrt(0.5))
    old, new = np.float32(kept), half * np.float32(math.sqrt(1.0 - kept * kept))
    noise_rms = half * np.float32(noise)
    beams, bins = power.shape
    for beam in prange(beams):
        drawn, more = np.empty((4, bins), np.uint32), np.empty((4, bins), np.uint32)
        draw_row(key, beam, 0, drawn)
        for cell in range(bins):
            pressure[beam, 0, cell] = noise_rms * variate(normal, drawn[2, cell])
            pressure[beam, 1, cell] = noise_rms * variate(normal, drawn[3, cell])
        if not speckled:
            continue
        scattered = power[beam].copy()
        if textured:
            draw_row(key, beam, 1, more)
            for cell in range(bins):
                if more[0, cell] * 2.0**-32 >= kept * kept:
                    texture[beam, cell] = variate(gamma, more[1, cell])
                scattered[cell] *= texture[beam, cell]
        for cell in range(bins):
            real = old * amplitude[0, beam, cell] + new * variate(normal, drawn[0, cell])
            imaginary = old * amplitude[1, beam, cell] + new * variate(normal, drawn[1, cell])
            amplitude[0, beam, cell], amplitude[1, beam, cell] = real, imaginary
            strength = np.sqrt(scattered[cell])
            pressure[beam, 0, cell] += strength * real
            pressure[beam, 1, cell] += strength * imaginary


@parallel_kernel
def _show(
    pressure: Float32,
    steady: Float32,
    taps: Float32,
    gain_db: Float32,
    ripple_db: Float32,
    gamma: float,
    image: Float32,
) -> None:
    """Blur by the pulse, detect, and show the pressure's magnitude to the power gamma.

    ``steady`` is power that is not speckled: it adds up as power, and then in phase with the noise.
    """
    beams, bins = image.shape
    per_db = np.float32(gamma / (20.0 * math.log10(2.0)))
    for beam in prange(beams):
        real, imaginary = _blurred(pressure[beam, 0], taps), _blurred(pressure[beam, 1], taps)
        if steady.shape[1] > 0:
            real += np.sqrt(_blurred(steady[beam], taps * taps))
        level_db = real * real + imaginary * imaginary
        _decibels(level_db)
        for cell in range(bins):
            octaves = (level_db[cell] + gain_db[cell] + ripple_db[beam]) * per_db
            image[beam, cell] = max(min(octaves, np.float32(0.0)), np.float32(-126.0))
        _powers_of_two(image[beam])
        for cell in range(bins):
            if level_db[cell] < np.float32(-380.0):
                image[beam, cell] = 0.0


@kernel
def _blurred(values: Float32, taps: Float32) -> Float32:
    """Values (bins,) convolved with an odd number of taps; nothing is beyond the ends."""
    bins, reach = len(values), len(taps) // 2
    found: Float32 = values * taps[reach]
    for k in range(1, reach + 1):
        weight = taps[reach + k]
        for cell in range(bins - k):
            found[cell] += weight * values[cell + k]
        for cell in range(k, bins):
            found[cell] += weight * values[cell - k]
    return found


@kernel
def _decibels(power: Float32) -> None:
    """Turn powers into dB where they are, to 1e-4 dB; 0 becomes -382, below all that is shown.

    Of a mantissa m in [1, 2), with s = (m - 1.5) / (m + 1.5), the logarithm is
    log 1.5 + 2 (s + s^3 / 3 + s^5 / 5 + ...); no call, so that LLVM vectorises it.
    """
    bits = power.view(np.int32)
    mantissa_bits = (bits & np.int32(0x7FFFFF)) | np.int32(0x3F800000)
    mantissa = mantissa_bits.view(np.float32)
    for k in range(len(power)):
        exponent = np.float32((bits[k] >> np.int32(23)) - np.int32(127))
        s = (mantissa[k] - np.float32(1.5)) / (mantissa[k] + np.float32(1.5))
        q = s * s
        series = np.float32(1 / 11) + q * np.float32(1 / 13)
        series = np.float32(1 / 7) + q * (np.float32(1 / 9) + q * series)
        series = np.float32(1 / 3) + q * (np.float32(1 / 5) + q * series)
        natural = np.float32(2.0) * s * (np.float32(1.0) + q * series)
        power[k] = exponent * _OCTAVE_DB + (natural * _NEPER_DB + _MIDDLE_DB)


@kernel
def _powers_of_two(values: Float32) -> None:
    """Turn x, from -126 to 0, into 2^x where they are, to 2e-7 of it; no call, as `_decibels`."""
    scale_bits = np.empty(len(values), np.int32)
    for k in range(len(values)):
        whole = np.floor(values[k] + np.float32(0.5))
        scale_bits[k] = (np.int32(whole) + np.int32(127)) << np.int32(23)
        y = (values[k] - whole) * _LN2
        series = np.float32(1 / 120) + y * np.float32(1 / 720)
        series = np.float32(1 / 6) + y * (np.float32(1 / 24) + y * series)
        series = np.float32(1.0) + y * (np.float32(1 / 2) + y * series)
        values[k] = np.float32(1.0) + y * series
    scale = scale_bits.view(np.float32)
    for k in range(len(values)):
        values[k] *= scale[k]
