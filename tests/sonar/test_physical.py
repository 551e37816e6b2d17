"""The sonar equation stage by stage, each noise by its distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy import stats

from insonify.scene import Body, Material, Scene
from insonify.scene.materials import material_named
from insonify.scene.seabed import procedural_seabed
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice
from insonify.sonar.histogram import EchoHistogram
from insonify.sonar.pattern import array_pattern, heard_by_all, leakage
from insonify.sonar.physical import (
    PhysicalSettings,
    Receiver,
    Speckle,
    form_physical,
)
from insonify.sonar.speckle import SpeckleField
from insonify.sonar.water import (
    Absorption,
    WaterSettings,
    ainslie_mccolm_db_per_km,
    francois_garrison_db_per_km,
)
from insonify.types import FanGeometry, Float32, Float64, Pose

GEOMETRY = FanGeometry(0.5, 0.2, 200, 400, 0.0, 40.0)
DEVICE = SonarDevice(
    frequency_khz=700.0, range_max_m=40.0, beams=200, bins=400, headroom_db=200.0,
    display_gamma=0.05,
)  # fmt: skip
"""It shows 200 dB over sand, and much below it."""
QUIET = PhysicalSettings(
    noise=False,
    volume_db=-200.0,
    side_lobes=False,
    pulse=False,
    speckle=Speckle.NONE,
    tvg_spreading=0.0,
    tvg_absorption=False,
    edge_db=0.0,
)
STILL = WaterSettings(absorption=Absorption.NONE)


def _received(image: Float32, receiver: Receiver, geometry: FanGeometry) -> Float64:
    """Levels in dB after the gain, from what is shown of them."""
    with np.errstate(divide="ignore"):
        shown_db = 20.0 / receiver.device.display_gamma * np.log10(image.astype(float))
    levels: Float64 = shown_db + receiver.full_db(geometry)
    return levels


def _levels(
    echo: Float64, settings: PhysicalSettings, water: WaterSettings = STILL, key: int = 0
) -> Float64:
    """Received levels in dB, after the gain."""
    histogram = EchoHistogram(echo.astype(np.float32), (echo > 0).astype(np.float32))
    receiver = Receiver(DEVICE, settings, water)
    image = form_physical(histogram, GEOMETRY, receiver, SpeckleField(), Pose(0, 0, 0), key)
    return _received(image, receiver, GEOMETRY)


FLAT = np.full((400, 200), 1e-3)
FLAT_ALL = np.ones((400, 200), np.float32)


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
    heard = GEOMETRY.bin_ranges_m < Receiver(DEVICE).far_m
    assert np.ptp(_levels(FLAT, gain, water)[heard][5:]) < 1e-2


def test_a_wall_has_the_level_of_its_lambert_law() -> None:
    wall = trimesh.creation.box((0.1, 400.0, 400.0))
    wall.apply_translation((10.45, 0.0, 0.0))
    scene = Scene((Body("wall", wall, Material("rock", 1.0, -10.0)),))
    device = SonarDevice(azimuth_fov_deg=10, elevation_fov_deg=10, beams=10, bins=20, tilt_deg=0,
                         range_max_m=20.0, headroom_db=200.0, display_gamma=0.05)  # fmt: skip
    image = Sonar(device, physical=QUIET, water=STILL).ping(scene, Pose(0, 0, 0)).image
    levels = _received(image, Receiver(device, QUIET, STILL), device.geometry)
    received = 10 ** (levels[:, 5] / 10)
    solid_angle = math.radians(1.0) * math.radians(10.0)
    expected = 200.0 - 10.0 - 20 * math.log10(10.5) + 10 * math.log10(solid_angle)
    assert 10 * math.log10(received.max()) == pytest.approx(expected, abs=0.05)


def test_noise_is_what_it_says_below_level_sand() -> None:
    """Against the seabed itself, traced."""
    device = SonarDevice(azimuth_fov_deg=4, elevation_fov_deg=20, beams=4, bins=400, tilt_deg=0,
                         range_max_m=40.0, headroom_db=200.0, display_gamma=0.05)  # fmt: skip
    sand = material_named("sand")
    assert sand is not None
    scene = Scene(
        (),
        procedural_seabed(
            np.random.default_rng(0),
            size_m=200.0,
            depth_m=0.0,
            relief_m=0.0,
            correlation_m=10.0,
            cell_m=5.0,
        ),
        sand,
    )
    image = Sonar(device, physical=QUIET).ping(scene, Pose(0, 0, 4.0, pitch_rad=0.12)).image
    receiver = Receiver(device, QUIET)
    levels = _received(image, receiver, device.geometry)
    far = int(receiver.far_m / device.geometry.bin_m)
    traced_db = 10 * math.log10((10 ** (levels[far - 4 : far + 4] / 10)).mean())
    assert traced_db == pytest.approx(receiver.sand_db(device.geometry), abs=0.2)
    assert receiver.noise_db(device.geometry) == receiver.sand_db(device.geometry) - 10.0


def test_the_gain_stops_where_noise_would_show() -> None:
    receiver = Receiver(DEVICE)
    gain_db, range_m = receiver.gain_db(GEOMETRY), GEOMETRY.bin_ranges_m
    assert (np.diff(gain_db[range_m < 28.0]) > 0).all()
    assert np.ptp(gain_db[range_m > 28.0]) == 0.0
    image = form_physical(
        EchoHistogram(np.zeros((400, 200), np.float32), np.zeros((400, 200), np.float32)),
        GEOMETRY, Receiver(DEVICE, PhysicalSettings(volume_db=-200.0)), SpeckleField(),
        Pose(0, 0, 0), 0,
    )  # fmt: skip
    levels = _received(image, receiver, GEOMETRY)
    far = 10 * math.log10((10 ** (levels[range_m > 28.0] / 10)).mean())
    assert far == pytest.approx(receiver.noise_db(GEOMETRY) + gain_db[-1], abs=0.05)


def test_water_scatters_up_to_what_stands_in_it() -> None:
    """Volume reverberation by hand: Sv, the cell's volume, and 40 log r (Urick, chapter 8)."""
    settings = QUIET.model_copy(update={"volume_db": -60.0})
    echo = np.zeros((400, 200))
    echo[200] = 1e-3
    levels = _levels(echo, settings)
    r = GEOMETRY.bin_ranges_m[100]
    volume_m3 = r**2 * (0.5 / 200) * 0.2 * GEOMETRY.bin_m
    sv = -60.0 + 40 * math.log10(0.7)
    expected = 200.0 - 40 * math.log10(r) + sv + 10 * math.log10(volume_m3)
    assert levels[100, 7] == pytest.approx(expected, abs=1e-3)
    assert np.isneginf(levels[201:]).all(), "a shadow"


def test_a_pulse_is_as_long_as_the_range_resolution() -> None:
    echo = np.zeros((400, 200))
    echo[200] = 1e-3
    device = DEVICE.model_copy(update={"range_resolution_m": 0.4})  # 4 bins
    receiver = Receiver(device, QUIET.model_copy(update={"pulse": True}), STILL)
    histogram = EchoHistogram(echo.astype(np.float32), (echo > 0).astype(np.float32))
    image = form_physical(histogram, GEOMETRY, receiver, SpeckleField(), Pose(0, 0, 0), 0)
    power = 10 ** (_received(image, receiver, GEOMETRY)[:, 3] / 10)
    assert power[198] / power[200] == pytest.approx(0.5, rel=1e-3)
    alone = 10 ** (_levels(echo, QUIET)[200, 3] / 10)
    assert power.sum() == pytest.approx(alone, rel=1e-3), "no energy is won or lost"


def test_speckle_is_as_large_as_a_resolution_cell() -> None:
    """Wide beams and long pulses make neighbours alike, as their patterns overlap."""
    device = DEVICE.model_copy(
        update={"range_resolution_m": 0.3, "beamwidth_deg": 2 * math.degrees(GEOMETRY.beam_rad)}
    )
    settings = QUIET.model_copy(
        update={"speckle": Speckle.RAYLEIGH, "side_lobes": True, "pulse": True}
    )
    receiver = Receiver(device, settings, STILL)
    flat = EchoHistogram((FLAT * GEOMETRY.bin_ranges_m[:, None] ** 2).astype(np.float32), FLAT_ALL)
    image = form_physical(flat, GEOMETRY, receiver, SpeckleField(), Pose(0, 0, 0), 0)
    power = 10 ** (_received(image, receiver, GEOMETRY) / 10)[20:-20, 20:-20]

    def alike(a: Float64, b: Float64) -> float:
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    taps = receiver.pulse_taps(GEOMETRY).astype(float)
    by_bin = float((taps[1:] * taps[:-1]).sum()) ** 2
    assert alike(power[1:], power[:-1]) == pytest.approx(by_bin, abs=0.03)
    heard = leakage(200, GEOMETRY.beam_rad, receiver.beam_rad(GEOMETRY), 0.85).astype(float)[100]
    by_beam = float((heard[1:] * heard[:-1]).sum()) ** 2
    assert by_beam > 0.4
    assert alike(power[:, 1:], power[:, :-1]) == pytest.approx(by_beam, abs=0.03)


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
    settings = QUIET.model_copy(update={"noise": True})
    level_db = Receiver(DEVICE, settings, STILL).noise_db(GEOMETRY)
    power = 10 ** ((_levels(np.zeros_like(FLAT), settings) - level_db) / 10)
    assert stats.kstest(power.ravel()[::7], stats.expon.cdf).pvalue > 0.01


def test_gains_of_beams_differ_as_asked() -> None:
    levels = _levels(FLAT, QUIET.model_copy(update={"ripple_db": 2.0})) - _levels(FLAT, QUIET)
    assert np.ptp(levels, axis=0).max() < 1e-3
    assert levels[0].std() == pytest.approx(2.0, rel=0.15)


def test_speckle_stays_at_rest_and_decorrelates_with_motion() -> None:
    beam_rad, wavelength_m = math.radians(1.0), 0.002
    aperture_m = 0.886 * wavelength_m / beam_rad
    device = DEVICE.model_copy(update={"frequency_khz": 1.5 / wavelength_m, "beamwidth_deg": 1.0})
    receiver = Receiver(device, QUIET.model_copy(update={"speckle": Speckle.RAYLEIGH}), STILL)
    flat = EchoHistogram((FLAT * GEOMETRY.bin_ranges_m[:, None] ** 2).astype(np.float32), FLAT_ALL)

    def correlation(pose: Pose) -> float:
        field = SpeckleField()
        images = [
            form_physical(flat, GEOMETRY, receiver, field, at, key)
            for key, at in enumerate((Pose(0, 0, 0), pose))
        ]
        before, after = (10 ** (_received(image, receiver, GEOMETRY) / 10) for image in images)
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


@pytest.mark.parametrize("beams", [1, 2, 3, 7, 96, 131])
@pytest.mark.parametrize("columns", [0, 1, 300])
def test_what_all_beams_hear_is_the_product_of_matrices(beams: int, columns: int) -> None:
    share = leakage(beams, math.radians(0.5), math.radians(1.0), 0.3)
    values = np.random.default_rng(0).standard_normal((beams, columns), dtype=np.float32)
    exact = share.astype(float) @ values.astype(float)
    np.testing.assert_allclose(heard_by_all(share, values), exact, atol=2e-6)


def test_a_strong_target_leaks_into_other_beams_and_energy_is_kept() -> None:
    echo = np.zeros((400, 200))
    echo[100, 100] = 1.0
    settings = QUIET.model_copy(update={"side_lobes": True, "taper": 0.0})
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
