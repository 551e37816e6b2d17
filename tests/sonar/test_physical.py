"""The sonar equation stage by stage, each noise by its distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy import stats

from insonify.scene import Body, Material, Scene
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice
from insonify.sonar.histogram import EchoHistogram
from insonify.sonar.physical import (
    PhysicalSettings,
    Receiver,
    Speckle,
    SpeckleField,
    array_pattern,
    form_physical,
)
from insonify.sonar.water import (
    Absorption,
    WaterSettings,
    ainslie_mccolm_db_per_km,
    francois_garrison_db_per_km,
)
from insonify.types import FanGeometry, Float64, Pose

GEOMETRY = FanGeometry(0.5, 0.2, 200, 400, 0.0, 40.0)
QUIET = PhysicalSettings(
    noise_level_db=-100.0,
    side_lobes=False,
    speckle=Speckle.NONE,
    tvg_spreading=0.0,
    tvg_absorption=False,
    edge_db=0.0,
    display_floor_db=0.0,
    display_range_db=300.0,
)
STILL = WaterSettings(absorption=Absorption.NONE)


def _levels(
    echo: np.ndarray,
    settings: PhysicalSettings,
    water: WaterSettings = STILL,
    key: int = 0,
) -> Float64:
    """Received levels in dB."""
    histogram = EchoHistogram(echo.astype(np.float32), (echo > 0).astype(np.float32))
    image = form_physical(
        histogram,
        GEOMETRY,
        Receiver(SonarDevice(frequency_khz=700.0), settings, water),
        SpeckleField(),
        Pose(0, 0, 0),
        key,
    )
    levels: Float64 = image.astype(float) * settings.display_range_db + settings.display_floor_db
    return levels


FLAT = np.full((400, 200), 1e-3)


def test_a_level_is_the_sonar_equation_by_hand() -> None:
    levels = _levels(FLAT, QUIET)
    r = GEOMETRY.bin_ranges_m[100]
    solid_angle = 0.5 / 200 * 0.2
    assert levels[100, 7] == pytest.approx(
        200.0 - 20 * math.log10(r) + 10 * math.log10(1e-3 * solid_angle), abs=1e-3
    )
    assert levels[50, 0] - levels[100, 0] == pytest.approx(
        20 * math.log10(r / GEOMETRY.bin_ranges_m[50]), abs=1e-3
    )


def test_absorption_is_lost_both_ways_and_given_back_by_the_gain() -> None:
    water = WaterSettings()
    alpha = water.absorption_db_per_m(700.0)
    lost = _levels(FLAT, QUIET) - _levels(FLAT, QUIET, water)
    np.testing.assert_allclose(lost[:, 0], 2 * alpha * GEOMETRY.bin_ranges_m, atol=1e-3)
    gain = QUIET.model_copy(update={"tvg_absorption": True, "tvg_spreading": 20.0})
    assert np.ptp(_levels(FLAT, gain, water)[5:]) < 1e-2


def test_a_wall_has_the_level_of_its_lambert_law() -> None:
    wall = trimesh.creation.box((0.1, 400.0, 400.0))
    wall.apply_translation((10.45, 0.0, 0.0))
    scene = Scene((Body("wall", wall, Material("rock", 1.0, -10.0)),))
    device = SonarDevice(azimuth_fov_deg=10, elevation_fov_deg=10, beams=10, bins=20, tilt_deg=0,
                         range_max_m=20.0)  # fmt: skip
    image = Sonar(device, physical=QUIET, water=STILL).ping(
        scene, Pose(0, 0, 0), np.random.default_rng(0)
    ).image  # fmt: skip
    received = 10 ** (image[:, 5].astype(float) * 30.0)
    solid_angle = math.radians(1.0) * math.radians(10.0)
    expected = 200.0 - 10.0 - 20 * math.log10(10.5) + 10 * math.log10(solid_angle)
    assert 10 * math.log10(received.max()) == pytest.approx(expected, abs=0.05)


def test_speckle_is_rayleigh() -> None:
    settings = QUIET.model_copy(update={"speckle": Speckle.RAYLEIGH})
    power = 10 ** ((_levels(FLAT, settings) - _levels(FLAT, QUIET)) / 10)
    assert stats.kstest(power.ravel()[::7], stats.expon.cdf).pvalue > 0.01
    assert (
        stats.kstest(np.sqrt(power.ravel()[::7]), stats.rayleigh(scale=0.5**0.5).cdf).pvalue > 0.01
    )


def test_k_speckle_has_the_moments_of_its_texture() -> None:
    settings = QUIET.model_copy(update={"speckle": Speckle.K, "k_shape": 3.0})
    power = 10 ** ((_levels(FLAT, settings) - _levels(FLAT, QUIET)) / 10)
    assert power.mean() == pytest.approx(1.0, rel=0.02)
    # <I^2> / <I>^2 = 2 (1 + 1 / nu)
    assert (power**2).mean() == pytest.approx(2 * (1 + 1 / 3), rel=0.08)


def test_receiver_noise_is_exponential_in_power_at_its_level() -> None:
    settings = QUIET.model_copy(update={"noise_level_db": 60.0})
    power = 10 ** (_levels(np.zeros_like(FLAT), settings) / 10)
    assert stats.kstest(power.ravel()[::7] / 1e6, stats.expon.cdf).pvalue > 0.01


def test_speckle_stays_at_rest_and_decorrelates_with_motion() -> None:
    beam_rad, wavelength_m = math.radians(1.0), 0.002
    aperture_m = 0.886 * wavelength_m / beam_rad
    device = SonarDevice(frequency_khz=1.5 / wavelength_m, beamwidth_deg=1.0)
    settings = QUIET.model_copy(update={"speckle": Speckle.RAYLEIGH})
    receiver = Receiver(device, settings, WaterSettings(sound_speed_mps=1500.0))
    geometry = FanGeometry(math.radians(300.0), 0.2, 300, 300, 0.0, 40.0)
    power = np.full((300, 300), 1e10, np.float32)

    def correlation(pose: Pose) -> float:
        field = SpeckleField()
        shown = [
            receiver.hear(power, geometry, field, at, key)
            for key, at in enumerate((Pose(0, 0, 0), pose))
        ]
        before, after = (10.0 ** (30.0 * image.astype(float)) for image in shown)
        return float(np.corrcoef(before.ravel(), after.ravel())[0, 1])

    assert correlation(Pose(0, 0, 0)) == pytest.approx(1.0)
    # powers correlate by the square of the field's exp(-(d / d0)^2)
    quarter = aperture_m / 4
    assert correlation(Pose(0, quarter, 0)) == pytest.approx(math.exp(-0.5), abs=0.02)
    turned = Pose(0, 0, 0, yaw_rad=beam_rad / 4)
    assert correlation(turned) == pytest.approx(math.exp(-0.5), abs=0.02)
    assert abs(correlation(Pose(0, 10 * aperture_m, 0))) < 0.02


@pytest.mark.parametrize("speckle", list(Speckle))
def test_a_skipped_ping_leaves_what_a_ping_leaves(speckle: Speckle) -> None:
    device = SonarDevice(beams=12, bins=40, frequency_khz=700.0)
    settings = PhysicalSettings(speckle=speckle)
    wall = trimesh.creation.box((0.1, 40.0, 40.0))
    wall.apply_translation((5.0, 0.0, 0.0))
    scene = Scene((Body("wall", wall, Material("rock", 1.0, -10.0)),))
    images = []
    for skip in (False, True):
        sonar, rng = Sonar(device, physical=settings), np.random.default_rng(3)
        if skip:
            sonar.skip(Pose(0, 0, 0), rng)
        else:
            sonar.ping(scene, Pose(0, 0, 0), rng)
        images.append(sonar.ping(scene, Pose(0, 1e-4, 0), rng).image)
    assert images[0].tobytes() == images[1].tobytes()


@pytest.mark.parametrize(("taper", "lobe_db"), [(0.0, -13.26), (1.0, -31.5), (0.852, -42.7)])
def test_beam_pattern_has_its_width_and_its_side_lobes(taper: float, lobe_db: float) -> None:
    beam_rad = math.radians(1.0)
    edge = array_pattern(np.array([0.0, beam_rad / 2]), beam_rad, taper)
    np.testing.assert_allclose(edge, [1.0, 0.5], rtol=1e-6)
    angles = np.linspace(0, 30 * beam_rad, 60001)
    levels = 10 * np.log10(array_pattern(angles, beam_rad, taper) + 1e-30)
    first_null = int(np.flatnonzero(np.diff(levels) > 0)[0])
    assert levels[first_null:].max() == pytest.approx(lobe_db, abs=0.7)


def test_a_strong_target_leaks_into_other_beams_and_energy_is_kept() -> None:
    echo = np.zeros((400, 200))
    echo[100, 100] = 1.0
    wide = {"display_floor_db": -200.0, "display_range_db": 500.0}
    settings = QUIET.model_copy(update={"side_lobes": True, "taper": 0.0} | wide)
    power = 10 ** (_levels(echo, settings)[100] / 10)
    alone = 10 ** (_levels(echo, QUIET)[100, 100] / 10)
    assert 0.0 < power[110] < power[101] < power[100]
    assert power.sum() == pytest.approx(alone, rel=0.01)


@pytest.mark.parametrize("frequency_khz", [1.0, 10.0, 100.0, 300.0, 700.0])
@pytest.mark.parametrize("depth_m", [0.0, 1000.0])
def test_both_absorption_formulas_agree_in_sea_water(frequency_khz: float, depth_m: float) -> None:
    given = (frequency_khz, 10.0, 35.0, depth_m, 8.0)
    theirs = ainslie_mccolm_db_per_km(*given)
    assert francois_garrison_db_per_km(*given) == pytest.approx(theirs, rel=0.12)


def test_absorption_has_known_values() -> None:
    # pure water absorbs 0.00025 f^2 dB/km at 20 degrees (Fisher and Simmons 1977), f in kHz
    assert francois_garrison_db_per_km(1000.0, 20.0, 0.0, 0.0, 7.0) == pytest.approx(217, rel=0.05)
    # sea water at 100 kHz: 30 to 40 dB/km (Urick 1983, fig. 5.5)
    assert 28.0 < francois_garrison_db_per_km(100.0, 10.0, 35.0, 0.0, 8.0) < 40.0
    assert WaterSettings(absorption=Absorption.NONE).absorption_db_per_m(700.0) == 0.0
