"""Modulation transfer of edges and lines with a known blur."""

import math

import numpy as np
import pytest
from scipy.special import erf

from simcore.quality.mtf import frequency_at, line_spread_mtf, peak_normalised, slanted_edge_mtf

PIXEL = 0.1


def slanted_edge(sigma: float, degrees: float = 3.0, shape: tuple[int, int] = (160, 200)) -> np.ndarray:
    """A Gaussian-blurred edge sampled at pixel centres (without a pixel aperture), from 10 to 13."""
    rows, columns = shape
    y, x = (np.arange(n) - (n - 1) / 2 for n in (rows, columns))
    angle = math.radians(degrees)
    distance = (x * math.cos(angle) - y[:, None] * math.sin(angle)) * PIXEL
    return 10.0 + 1.5 * (1 + erf(distance / (sigma * math.sqrt(2))))


def gaussian_mtf(frequency: np.ndarray, sigma: float) -> np.ndarray:
    return np.exp(-2 * (math.pi * sigma * frequency) ** 2)


@pytest.mark.parametrize("sigma", [0.06, 0.1, 0.2])
@pytest.mark.parametrize("degrees", [2.0, 3.0, -6.0])
def test_slanted_edge_of_known_gaussian_blur(sigma: float, degrees: float):
    frequency, mtf = slanted_edge_mtf(slanted_edge(sigma, degrees), PIXEL)
    assert frequency[-1] == pytest.approx(10.0, rel=0.02)
    assert mtf == pytest.approx(gaussian_mtf(frequency, sigma), abs=0.01)


def test_a_falling_edge_gives_the_same():
    rising = slanted_edge(0.1)
    frequency, mtf = slanted_edge_mtf(rising, PIXEL)
    frequency_falling, falling = slanted_edge_mtf(-2.0 * rising + 5.0, PIXEL)
    assert np.array_equal(frequency, frequency_falling)
    assert falling == pytest.approx(mtf, abs=1e-9)


def test_pixel_aperture_multiplies_the_transfer():
    fine = slanted_edge(0.05, 3.0, (160, 1000))
    # Means over five pixels: an aperture of 5 pixels, that is of one pixel five times as large.
    coarse = fine.reshape(32, 5, 200, 5).mean(axis=(1, 3))
    frequency, mtf = slanted_edge_mtf(coarse, 5 * PIXEL, half_width_mm=20.0)
    angle = math.radians(3.0)
    aperture = np.sinc(frequency * 5 * PIXEL * math.cos(angle)) * np.sinc(frequency * 5 * PIXEL * math.sin(angle))
    assert mtf == pytest.approx(np.abs(aperture) * gaussian_mtf(frequency, 0.05), abs=0.03)


def test_an_upright_edge_and_an_image_without_edge_are_refused():
    with pytest.raises(ValueError, match=r"moves by 0\.00 pixels"):
        slanted_edge_mtf(slanted_edge(0.1, 0.0), PIXEL)
    with pytest.raises(ValueError, match="no edge"):
        slanted_edge_mtf(np.ones((50, 50)), PIXEL)


def test_line_spread_function_of_a_gaussian():
    x = np.arange(-512, 512) * 0.02
    frequency, mtf = line_spread_mtf(np.exp(-0.5 * (x / 0.15) ** 2), 0.02)
    assert mtf == pytest.approx(gaussian_mtf(frequency, 0.15), abs=1e-9)
    assert frequency_at(frequency, mtf) == pytest.approx(math.sqrt(math.log(2) / 2) / (math.pi * 0.15), rel=1e-2)


def test_a_system_without_mean_value_is_normalised_at_its_peak():
    x = np.arange(-512, 512) * 0.02
    line = -np.gradient(np.gradient(np.exp(-0.5 * (x / 0.15) ** 2)))  # f^2 times a Gaussian
    with pytest.raises(ValueError, match="no area"):
        line_spread_mtf(line, 0.02)
    frequency, mtf = peak_normalised(line, 0.02)
    assert frequency[int(np.argmax(mtf))] == pytest.approx(1 / (math.pi * 0.15 * math.sqrt(2)), rel=0.03)
    assert mtf.max() == 1.0
    assert frequency_at(frequency, mtf) > 1 / (math.pi * 0.15 * math.sqrt(2))
    assert frequency_at(frequency, np.ones(len(mtf))) == math.inf
