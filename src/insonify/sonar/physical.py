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
import numpy.typing as npt
from pydantic import Field

from insonify.config.settings import Settings
from insonify.frames import transform_from_pose
from insonify.sonar.devices import SonarDevice
from insonify.sonar.histogram import EchoHistogram
from insonify.sonar.water import WaterSettings
from insonify.types import FanGeometry, Float32, Float64, Pose

Complex64 = npt.NDArray[np.complex64]


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
    sees the same speckle again.
    """

    pose: Pose | None = None
    amplitude: Complex64 = field(default_factory=lambda: np.empty((0, 0), np.complex64))
    texture: Float32 = field(default_factory=lambda: np.empty((0, 0), np.float32))

    def move(
        self,
        shape: tuple[int, int],
        pose: Pose,
        beam_rad: float,
        wavelength_m: float,
        k_shape: float | None,
        rng: np.random.Generator,
    ) -> Float32:
        """Intensity (bins, beams) with mean 1 that multiplies the echoes of a ping at a pose."""
        kept = 0.0
        if self.pose is not None and self.amplitude.shape == shape:
            kept = _correlation(self.pose, pose, beam_rad, wavelength_m)
        if kept == 0.0:
            self.amplitude = np.zeros(shape, np.complex64)
            self.texture = np.ones(shape, np.float32)
        if kept < 1.0:
            fresh = complex_noise(shape, rng) * np.float32(math.sqrt(1.0 - kept * kept))
            self.amplitude = self.amplitude * np.float32(kept) + fresh
        if k_shape is not None and kept < 1.0:
            new = rng.random(shape, np.float32) >= kept * kept if kept else np.ones(shape, bool)
            drawn = rng.standard_gamma(k_shape, int(new.sum()), np.float32)
            self.texture[new] = drawn / np.float32(k_shape)
        self.pose = pose
        power = self.amplitude.real**2 + self.amplitude.imag**2
        return (power * self.texture if k_shape is not None else power).astype(np.float32)


def _correlation(before: Pose, now: Pose, beam_rad: float, wavelength_m: float) -> float:
    moved_m = math.dist(before.position_m, now.position_m)
    turned = transform_from_pose(before)[:3, :3].T @ transform_from_pose(now)[:3, :3]
    turned_rad = math.acos(min(1.0, max(-1.0, (float(np.trace(turned)) - 1.0) / 2.0)))
    aperture_m = 0.886 * wavelength_m / beam_rad
    if moved_m == 0.0 and turned_rad < 1e-7:
        return 1.0
    far = (2.0 * moved_m / aperture_m) ** 2 + (2.0 * turned_rad / beam_rad) ** 2
    return math.exp(-far) if far < 30.0 else 0.0


def complex_noise(shape: tuple[int, int], rng: np.random.Generator) -> Complex64:
    """Complex Gaussian noise of mean power 1."""
    parts = rng.standard_normal((*shape, 2), dtype=np.float32) * np.float32(math.sqrt(0.5))
    return parts.view(np.complex64)[..., 0]


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

    def move(
        self, speckle: SpeckleField, geometry: FanGeometry, pose: Pose, rng: np.random.Generator
    ) -> Float32:
        """The speckle of the next ping (`SpeckleField.move`): the first that is drawn for it."""
        k_shape = self.settings.k_shape if self.settings.speckle is Speckle.K else None
        wavelength_m = self.water.sound_speed_mps / (1000.0 * self.device.frequency_khz)
        shape = (geometry.bins, geometry.beams)
        return speckle.move(shape, pose, self.beam_rad(geometry), wavelength_m, k_shape, rng)


def form_physical(
    echoes: EchoHistogram,
    geometry: FanGeometry,
    receiver: Receiver,
    speckle: SpeckleField,
    pose: Pose,
    rng: np.random.Generator,
) -> Float32:
    """The image of an echo histogram rendered with Lambert's law, (bins, beams) in [0, 1].

    Args:
        echoes: What a renderer saw.
        geometry: Of the sonar.
        receiver: What hears them.
        speckle: The sonar's speckle; it moves on to this ping.
        pose: Where the sonar is.
        rng: Where noise comes from.
    """
    device, settings, water = receiver.device, receiver.settings, receiver.water
    range_m = np.maximum(geometry.bin_ranges_m, geometry.bin_m / 2)[:, None]
    alpha = water.absorption_db_per_m(device.frequency_khz)
    level_db = settings.source_level_db - 20.0 * np.log10(range_m) - 2.0 * alpha * range_m
    solid_angle = geometry.beam_rad * geometry.elevation_fov_rad
    power = (10.0 ** (level_db / 10.0) * solid_angle).astype(np.float32) * echoes.echo
    if settings.side_lobes and geometry.beams > 1:
        beam_rad = receiver.beam_rad(geometry)
        power = power @ _leakage(geometry.beams, geometry.beam_rad, beam_rad, settings.taper)
    if settings.speckle is not Speckle.NONE:
        power = power * receiver.move(speckle, geometry, pose, rng)
    if settings.noise_level_db > -100.0:
        noise = np.float32(10.0 ** (settings.noise_level_db / 20.0))
        heard = np.sqrt(power) + noise * complex_noise(power.shape, rng)
        power = heard.real**2 + heard.imag**2
    gain_db = settings.tvg_spreading * np.log10(range_m)
    if settings.tvg_absorption:
        gain_db = gain_db + 2.0 * alpha * range_m
    with np.errstate(divide="ignore"):
        shown_db = 10.0 * np.log10(power) + (gain_db - settings.display_floor_db).astype(np.float32)
    image: Float32 = np.clip(shown_db / np.float32(settings.display_range_db), 0.0, 1.0)
    return image.astype(np.float32)


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
