"""What each sensor's errors are, against the figures they are given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from insonify.types import Float32, Float64
from insonify.vehicle.instruments import Clock, CompassSettings, DvlSettings, ImuSettings
from insonify.vehicle.plant.sensors import Compass, Dvl, Imu


def test_clocks_keep_their_rate_whatever_the_time_between_questions() -> None:
    clock = Clock(3.0)
    asked = [round(0.05 * k, 9) for k in range(20 * 10)]
    due = [t for t in asked if clock.due(t)]
    assert len(due) == 30
    assert max(abs(t - k / 3.0) for k, t in enumerate(due)) <= 0.05 + 1e-9


def test_imu_noise_density_and_bias_walk(rng: np.random.Generator) -> None:
    settings = ImuSettings(accel_walk=0.01)
    imu = Imu(settings, rng)
    start = imu.bias.copy()
    readings = imu.sample(np.zeros((100_000, 6)))
    # the mean of a second of white noise has the density as its standard deviation
    gyro = readings[:, 3:].reshape(-1, 100, 3).mean(axis=1)
    assert np.diff(gyro, axis=0).std() / math.sqrt(2) == pytest.approx(9e-5, rel=0.1)
    assert np.abs(imu.bias[:3] - start[:3]).max() < 4 * 0.01 * math.sqrt(1000.0)
    again = np.array([Imu(settings, np.random.default_rng(k)).bias for k in range(400)])
    assert again[:, :3].std() == pytest.approx(0.02, rel=0.1)
    assert again[:, 3:].std() == pytest.approx(5e-4, rel=0.1)


def _bottom(range_m: float, square: float) -> object:
    def sound(origin_m: Float64, directions: Float32) -> tuple[Float64, Float64]:
        return np.full(4, range_m), np.full(4, square)

    return sound


def test_dvl_beams_measure_the_velocity_along_them(rng: np.random.Generator) -> None:
    dvl = Dvl(DvlSettings(noise_m_s=1e-9, scale=1e-9), rng)
    velocity, rate = np.array([0.5, -0.2, 0.1]), np.array([0.0, 0.0, 0.2])
    sound = _bottom(5.0, 0.9)
    readings = dvl.sample(np.zeros(3), np.eye(3), velocity, rate, sound)  # type: ignore[arg-type]
    np.testing.assert_allclose(np.linalg.norm(dvl.beams, axis=1), 1.0)
    np.testing.assert_allclose(dvl.beams[:, 2], -math.cos(math.radians(22.5)))
    solved = np.linalg.lstsq(dvl.beams, readings, rcond=None)[0]
    np.testing.assert_allclose(solved, velocity, atol=1e-7)  # the arm is below: no turn shows


@pytest.mark.parametrize(
    ("range_m", "square", "locked"),
    [
        (5.0, 0.9, True),
        (60.0, 0.9, False),
        (math.inf, 0.0, False),
        (5.0, 0.3, False),
        (0.05, 0.9, False),
    ],
)
def test_dvl_loses_the_bottom_when_far_near_or_steep(
    rng: np.random.Generator, range_m: float, square: float, locked: bool
) -> None:
    sound = _bottom(range_m, square)
    readings = Dvl(DvlSettings(), rng).sample(
        np.zeros(3),
        np.eye(3),
        np.zeros(3),
        np.zeros(3),
        sound,  # type: ignore[arg-type]
    )
    assert np.isfinite(readings).all() == locked
    assert np.isnan(readings).all() != locked


def test_compass_deviation_has_its_spread_and_memory(rng: np.random.Generator) -> None:
    settings = CompassSettings(rate_hz=10.0, deviation_s=5.0, noise_deg=0.1)
    compass = Compass(settings, rng)
    deviations = []
    for _ in range(40_000):
        compass.sample(1.0)
        deviations.append(compass.deviation)
    d = np.degrees(deviations)
    assert d.std() == pytest.approx(0.5, rel=0.1)
    assert (d[50:] @ d[:-50]) / (d @ d) == pytest.approx(math.exp(-1.0), abs=0.07)
