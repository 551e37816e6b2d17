"""From echoes to an image by the sonar equation, in dB re 1 uPa; nothing depends on the frame.

The echo of a cell is the backscatter of the surface in it, per solid angle.  A patch of a surface
with Lambert's coefficient mu, seen at an angle of incidence a over a solid angle dW, scatters back
``mu cos^2 a`` times its area ``r^2 dW / cos a``; so the level received is

    RL = SL - 2 TL + 10 log10(r^2 sum(mu cos a dW)),  TL = 20 log10 r + alpha r

(Urick, Principles of Underwater Sound, 1983, chapters 2 and 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache
from typing import Any

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.frames import transform_from_pose
from insonify.jit import kernel, parallel_kernel, prange
from insonify.sonar.devices import SonarDevice
from insonify.sonar.draws import draw_row, gamma_table, normal_table, variate
from insonify.sonar.histogram import EchoHistogram
from insonify.sonar.water import WaterSettings
from insonify.types import FanGeometry, Float32, Float64, Pose

_DB_PER_OCTAVE = np.float32(10.0 * math.log10(2.0))
_DB_PER_NEPER = np.float32(10.0 / math.log(10.0))
_DB_OF_MIDDLE = np.float32(10.0 * math.log10(1.5))


class Speckle(StrEnum):
    """How the echoes of many scatterers in a cell add up."""

    RAYLEIGH = "rayleigh"
    K = "k"
    NONE = "none"


class PhysicalSettings(Settings):
    """The stages of the physical model.

    No maker publishes source levels of the devices here; the defaults give an imaging sonar whose
    seabed echoes drown in noise at some 100 m at 720 kHz.
    """

    source_level_db: float = Field(200.0, ge=0, le=260, description="SL, dB re 1 uPa at 1 m")
    noise_level_db: float = Field(
        60.0, ge=-100, le=200, description="receiver noise in a bin, dB re 1 uPa; -100: none"
    )
    edge_db: float = Field(
        3.0, ge=0, le=40, description="one-way loss at the beam's upper and lower edge"
    )
    taper: float = Field(
        0.85, ge=0, le=1, description="of the array: 0 uniform, side lobes -13 dB; 0.85 Hamming"
    )
    side_lobes: bool = Field(True, description="echoes leak into other beams")
    speckle: Speckle = Field(Speckle.RAYLEIGH, description="rayleigh, k or none")
    k_shape: float = Field(2.0, gt=0, le=1000, description="nu of the K distribution's texture")
    tvg_spreading: float = Field(
        30.0, ge=0, le=80, description="time-varying gain of so much log10 r, dB"
    )
    tvg_absorption: bool = Field(True, description="and of 2 alpha r")
    second_bounce: bool = Field(
        False, description="echoes by way of a second surface, which mirrors (Embree only)"
    )
    surface_mirror: bool = Field(
        False, description="echoes by way of the water's surface at z = 0 (Embree only)"
    )
    display_floor_db: float = Field(115.0, ge=-200, le=300, description="level that is shown as 0")
    display_range_db: float = Field(60.0, gt=0, le=300, description="from there to 1")


@dataclass(slots=True)
class SpeckleField:
    """Speckle of one sonar, which changes as it moves.

    The field of a cell is complex Gaussian.  It keeps a correlation of
    ``exp(-(d / d0)^2 - (a / a0)^2)`` when the sonar moves by d and turns by a, with d0 half the
    length of the aperture that the beamwidth implies and a0 half the beamwidth: a sonar at rest
    sees the same speckle again.  With K speckle a cell has a texture too, which it keeps with that
    probability, squared.

    Attributes:
        pose: Of the last ping.
        amplitude: (2, beams, bins) float32, the field's real and imaginary part.
        texture: (beams, bins) float32.
    """

    pose: Pose | None = None
    amplitude: Float32 = field(default_factory=lambda: np.zeros((2, 0, 0), np.float32))
    texture: Float32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    def move(
        self, shape: tuple[int, int], pose: Pose, beam_rad: float, wavelength_m: float
    ) -> float:
        """Go on to the pose of the next ping, of (beams, bins); how much the field keeps."""
        kept = 0.0
        if self.pose is not None and self.texture.shape == shape:
            kept = _correlation(self.pose, pose, beam_rad, wavelength_m)
        if self.texture.shape != shape:
            self.amplitude = np.zeros((2, *shape), np.float32)
            self.texture = np.zeros(shape, np.float32)
        self.pose = pose
        return kept


def _correlation(before: Pose, now: Pose, beam_rad: float, wavelength_m: float) -> float:
    moved_m = math.dist(before.position_m, now.position_m)
    turned = transform_from_pose(before)[:3, :3].T @ transform_from_pose(now)[:3, :3]
    turned_rad = math.acos(min(1.0, max(-1.0, (float(np.trace(turned)) - 1.0) / 2.0)))
    aperture_m = 0.886 * wavelength_m / beam_rad
    if moved_m == 0.0 and turned_rad < 1e-7:
        return 1.0
    far = (2.0 * moved_m / aperture_m) ** 2 + (2.0 * turned_rad / beam_rad) ** 2
    return math.exp(-far) if far < 30.0 else 0.0


@dataclass(frozen=True, slots=True)
class Receiver:
    """What the sonar equation needs to know.

    Attributes:
        device: The sonar: its frequency and beamwidth.
        settings: Which stages, how strong.
        water: Absorption and speed of sound.
    """

    device: SonarDevice
    settings: PhysicalSettings = PhysicalSettings()
    water: WaterSettings = WaterSettings()

    def beam_rad(self, geometry: FanGeometry) -> float:
        """Its beams' width; as wide as they are apart where the device does not say."""
        return math.radians(self.device.beamwidth_deg) or geometry.beam_rad

    def hear(
        self, power: Float32, geometry: FanGeometry, speckle: SpeckleField, pose: Pose, key: int
    ) -> Float32:
        """Power with speckle and noise as it is shown, (beams, bins) in [0, 1].

        Args:
            power: (beams, bins) float32, re 1 uPa^2; it is not changed.
            geometry: Of the sonar.
            speckle: The sonar's speckle; it moves on to this ping.
            pose: Where the sonar is.
            key: Of the ping, 64 bits; the same key draws the same noise (`sonar.draws`).
        """
        settings = self.settings
        wavelength_m = self.water.sound_speed_mps / (1000.0 * self.device.frequency_khz)
        kept = speckle.move(power.shape, pose, self.beam_rad(geometry), wavelength_m)
        k_speckle = settings.speckle is Speckle.K
        noise = (
            10.0 ** (settings.noise_level_db / 20.0) if settings.noise_level_db > -100.0 else 0.0
        )
        image = np.empty_like(power)
        _hear(
            power, self._gain_db(geometry), speckle.amplitude, speckle.texture, kept,
            settings.speckle is not Speckle.NONE, k_speckle,
            gamma_table(settings.k_shape if k_speckle else 1.0), normal_table(), noise,
            np.uint64(key), settings.display_range_db, image,
        )  # fmt: skip
        return image

    def level(self, geometry: FanGeometry) -> Float32:
        """Power of an echo of strength 1 in each bin, (bins,), re 1 uPa^2."""
        range_m, alpha = self._ranges_m(geometry), self._absorption_db_per_m
        level_db = self.settings.source_level_db - 20.0 * np.log10(range_m) - 2.0 * alpha * range_m
        solid_angle = geometry.beam_rad * geometry.elevation_fov_rad
        level: Float32 = (10.0 ** (level_db / 10.0) * solid_angle).astype(np.float32)
        return level

    def _gain_db(self, geometry: FanGeometry) -> Float32:
        """What is added to levels in each bin before they are shown from 0, (bins,)."""
        range_m = self._ranges_m(geometry)
        gain_db = self.settings.tvg_spreading * np.log10(range_m) - self.settings.display_floor_db
        if self.settings.tvg_absorption:
            gain_db = gain_db + 2.0 * self._absorption_db_per_m * range_m
        return gain_db.astype(np.float32)

    @property
    def _absorption_db_per_m(self) -> float:
        return self.water.absorption_db_per_m(self.device.frequency_khz)

    def _ranges_m(self, geometry: FanGeometry) -> Float64:
        return np.maximum(geometry.bin_ranges_m, geometry.bin_m / 2)


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
    power = echoes.echo.T * receiver.level(geometry)
    if settings.side_lobes and geometry.beams > 1:
        beam_rad = receiver.beam_rad(geometry)
        power = _leakage(geometry.beams, geometry.beam_rad, beam_rad, settings.taper).T @ power
    return receiver.hear(np.ascontiguousarray(power), geometry, speckle, pose, key).T


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
        power[k] = exponent * _DB_PER_OCTAVE + (natural * _DB_PER_NEPER + _DB_OF_MIDDLE)


@parallel_kernel
def _hear(
    power: Float32,
    gain_db: Float32,
    amplitude: Float32,
    texture: Float32,
    kept: float,
    speckled: bool,
    textured: bool,
    gamma: Float32,
    normal: Float32,
    noise: float,
    key: np.uint64,
    shown_db: float,
    image: Float32,
) -> None:
    """Move the speckle on, hear (beams, bins) through it and the noise, and show it in dB."""
    half = np.float32(math.sqrt(0.5))
    old, new = np.float32(kept), half * np.float32(math.sqrt(1.0 - kept * kept))
    noise_rms, per_db = half * np.float32(noise), np.float32(1.0 / shown_db)
    beams, bins = power.shape
    for beam in prange(beams):
        drawn, more = np.empty((4, bins), np.uint32), np.empty((4, bins), np.uint32)
        draw_row(key, beam, 0, drawn)
        heard = power[beam].copy()
        if speckled:
            for cell in range(bins):
                real = old * amplitude[0, beam, cell] + new * variate(normal, drawn[0, cell])
                imaginary = old * amplitude[1, beam, cell] + new * variate(normal, drawn[1, cell])
                amplitude[0, beam, cell], amplitude[1, beam, cell] = real, imaginary
                heard[cell] *= real * real + imaginary * imaginary
        if textured:
            draw_row(key, beam, 1, more)
            for cell in range(bins):
                if more[0, cell] * 2.0**-32 >= kept * kept:
                    texture[beam, cell] = variate(gamma, more[1, cell])
                heard[cell] *= texture[beam, cell]
        if noise_rms > 0.0:
            for cell in range(bins):
                real = np.sqrt(heard[cell]) + noise_rms * variate(normal, drawn[2, cell])
                imaginary = noise_rms * variate(normal, drawn[3, cell])
                heard[cell] = real * real + imaginary * imaginary
        _decibels(heard)
        for cell in range(bins):
            shown = (heard[cell] + gain_db[cell]) * per_db
            image[beam, cell] = min(max(shown, np.float32(0.0)), np.float32(1.0))


def array_pattern(angle_rad: Float64, beam_rad: float, taper: float) -> Float64:
    """Power pattern of a line array with the taper ``1 + taper cos``, -3 dB at half ``beam_rad``.

    The transform of the taper is three sincs; uniform weights (0) give side lobes of -13 dB, a
    taper of 0.85 (Hamming) below -40 dB.
    """
    u = np.sin(np.asarray(angle_rad)) / math.sin(beam_rad / 2) * _half_power_u(taper)
    return _tapered(u, taper) ** 2


def _tapered(u: Any, taper: float) -> Float64:
    beam: Float64 = np.sinc(u) + taper / 2.0 * (np.sinc(u - 1.0) + np.sinc(u + 1.0))
    return beam


@lru_cache(maxsize=8)
def _half_power_u(taper: float) -> float:
    """Where the pattern of a taper has fallen to one half."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        above = float(_tapered(middle, taper)) ** 2 > 0.5
        low, high = (middle, high) if above else (low, middle)
    return low


@lru_cache(maxsize=8)
def _leakage(beams: int, spacing_rad: float, beam_rad: float, taper: float) -> Float32:
    """How much of each beam's echo every beam hears, (beams, beams), rows adding up to 1."""
    beam = np.arange(beams)
    apart = np.clip((beam[:, None] - beam) * spacing_rad, -np.pi / 2, np.pi / 2)
    heard = array_pattern(apart, beam_rad, taper)
    middle = heard[beams // 2].sum()
    leakage: Float32 = (heard / middle).astype(np.float32)
    return leakage
