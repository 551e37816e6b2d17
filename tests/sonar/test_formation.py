from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from insonify.sonar.formation import ImageSettings, form_image, normalise_energy
from insonify.sonar.histogram import EchoHistogram


def _sigmoid(value: float, slope: float, centre: float) -> float:
    return 1.0 / (1.0 + math.exp(-slope * (value - centre)))


def test_equation_1_is_the_mean_of_the_sigmoid_in_each_cell() -> None:
    intensities = [0.1, 0.5, 0.9]
    echoes = [_sigmoid(i, 6.0, 0.3) for i in intensities]
    histogram = EchoHistogram(
        np.array([[sum(echoes), 0.0]], np.float32), np.array([[3.0, 0.0]], np.float32)
    )
    image = normalise_energy(histogram)
    assert image[0, 0] == pytest.approx((0.2314752 + 0.7685248 + 0.9734030) / 3, abs=1e-6)
    assert image[0, 1] == 0.0


def test_equation_2_speckle_is_skew_normal_with_mean_one() -> None:
    ones = EchoHistogram(np.full((500, 400), 0.25, np.float32), np.ones((500, 400), np.float32))
    image = form_image(ones, ImageSettings(speckle=0.2, speckle_skew=0.9, noise=0.0), 1)
    noise = 4.0 * image.ravel().astype(float)
    assert noise.mean() == pytest.approx(1.0, abs=2e-3)
    assert noise.std() == pytest.approx(0.2, rel=5e-3)
    delta = 0.9
    shape = delta / math.sqrt(1 - delta**2)
    scale = 0.2 / math.sqrt(1 - 2 * delta**2 / math.pi)
    location = 1.0 - scale * delta * math.sqrt(2 / math.pi)
    fit = stats.kstest(noise[::10], stats.skewnorm(shape, location, scale).cdf)
    assert fit.pvalue > 0.01
    assert np.median(noise) < noise.mean(), "skewed towards low values"


def test_speckle_multiplies_and_noise_adds() -> None:
    one = EchoHistogram(np.full((300, 300), 0.5, np.float32), np.ones((300, 300), np.float32))
    none = EchoHistogram(np.zeros((300, 300), np.float32), np.zeros((300, 300), np.float32))
    only_speckle = ImageSettings(speckle=0.1, noise=0.0)
    only_noise = ImageSettings(speckle=0.0, noise=0.03)
    bright = form_image(one, only_speckle, 0)
    assert bright.std() == pytest.approx(0.05, rel=0.02)
    assert form_image(none, only_speckle, 0).max() == 0.0
    level = form_image(one, only_noise, 0)
    assert stats.kstest(level.ravel()[::9], stats.norm(0.5, 0.03).cdf).pvalue > 0.01


def test_same_seed_same_image_and_always_within_bounds() -> None:
    histogram = EchoHistogram(np.full((64, 32), 0.9, np.float32), np.ones((64, 32), np.float32))
    settings = ImageSettings(speckle=0.8, noise=0.5)
    a = form_image(histogram, settings, 5)
    b = form_image(histogram, settings, 5)
    c = form_image(histogram, settings, 6)
    assert a.tobytes() == b.tobytes() != c.tobytes()
    assert a.dtype == np.float32
    assert a.min() >= 0.0 and a.max() <= 1.0
