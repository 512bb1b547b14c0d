"""Power-law exponents and noise power of synthetic fields whose spectrum is known."""

import numpy as np
import pytest

from simcore.quality.noise import noise_power
from simcore.quality.texture import (
    detrended,
    periodogram,
    power_law_exponent,
    regions_inside,
    ring_average,
    texture,
)

PIXEL = 0.1


def power_law_field(beta: float, size: int, pixel: float, seed: int) -> np.ndarray:
    """Gaussian field (size, size) with the spectrum 1 / f^beta at every frequency but 0."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(size, pixel)[:, None], np.fft.fftfreq(size, pixel))
    frequency[0, 0] = np.inf
    return np.fft.ifft2(np.fft.fft2(random.standard_normal((size, size))) * frequency ** (-beta / 2)).real


@pytest.mark.parametrize("beta", [0.0, 1.8, 3.0, 4.0])
def test_exponent_of_power_law_fields(beta: float):
    # Cut out of a field four times as wide: not periodic in the region, as no breast is.
    field = power_law_field(beta, 1024, PIXEL, seed=3)
    result = texture(field, np.ones(field.shape, bool), PIXEL)
    assert result.roi_pixels == 256
    assert len(result.betas) == 49
    error_of_mean = result.betas.std() / np.sqrt(16)  # half-overlapping squares: 16 of them are independent
    assert result.betas.mean() == pytest.approx(beta, abs=3 * error_of_mean)
    assert error_of_mean < 0.1


def test_exponent_does_not_change_with_scale_offset_and_slope():
    field = power_law_field(3.0, 256, PIXEL, seed=5)
    rows, columns = np.indices(field.shape)
    beta = power_law_exponent(field, PIXEL)
    assert power_law_exponent(7.0 * field + 0.3 * rows - 0.2 * columns + 40.0, PIXEL) == pytest.approx(beta, abs=1e-9)


def test_detrending_removes_a_plane_and_nothing_else():
    rows, columns = np.indices((20, 31))
    assert np.abs(detrended(2.0 + 0.5 * rows - 0.25 * columns)).max() < 1e-12
    saddle = (rows - 9.5) * (columns - 15.0)  # orthogonal to every plane
    assert np.abs(detrended(saddle + rows) - saddle).max() < 1e-11


def test_too_small_a_region_is_refused_with_its_frequencies():
    with pytest.raises(ValueError, match=r"64 pixels of 0.1 mm give 3 frequencies"):
        power_law_exponent(power_law_field(3.0, 64, PIXEL, seed=1), PIXEL)
    with pytest.raises(ValueError, match="flat"):
        power_law_exponent(np.ones((256, 256)), PIXEL)


def test_a_wave_appears_at_its_frequency_with_its_power():
    n, waves = 128, 12
    phase = 2 * np.pi * waves * np.arange(n) / n
    image = np.broadcast_to(3.0 * np.cos(phase), (n, n))
    power = periodogram(image, PIXEL)
    frequency, mean = ring_average(power, PIXEL)
    assert frequency[int(np.argmax(mean))] == pytest.approx(waves / (n * PIXEL), rel=0.02)
    # Parseval: the integral over all frequencies is the mean square, 9 / 2.
    assert power.sum() / (n * PIXEL) ** 2 == pytest.approx(4.5, rel=1e-3)


def test_white_noise_has_the_power_of_its_variance():
    regions = 2.0 * np.random.default_rng(0).standard_normal((60, 64, 64))
    frequency, power = noise_power(regions, PIXEL)
    assert frequency[0] < 0.3
    assert frequency[-1] > 4.5
    # Away from the detrended lowest frequencies.
    assert power[3:] == pytest.approx(4.0 * PIXEL**2, rel=0.1)
    assert power[3:].mean() == pytest.approx(4.0 * PIXEL**2, rel=0.01)


def test_regions_lie_wholly_inside_and_depend_on_the_mask_alone():
    rows, columns = np.indices((120, 90))
    mask = np.hypot(rows - 60, columns) < 50
    regions = regions_inside(mask, 16)
    assert regions
    assert all(mask[r].all() for r in regions)
    assert all(mask[r].shape == (16, 16) for r in regions)
    moved = regions_inside(np.pad(mask, ((13, 0), (0, 0))), 16)
    assert [(r.start + 13, c.start) for r, c in regions] == [(r.start, c.start) for r, c in moved]
    assert regions_inside(np.zeros((50, 50), bool), 16) == []


def test_smaller_regions_where_the_mask_is_small_and_none_where_there_is_no_room():
    field = power_law_field(2.0, 256, PIXEL, seed=2)
    mask = np.zeros(field.shape, bool)
    mask[10:150, 20:170] = True
    report = texture(field, mask, PIXEL).report()
    assert (report["roi_pixels"], report["roi_mm"]) == (128, 12.8)
    assert report["rois"] == 1
    assert report["beta_std"] is None
    assert texture(field, np.zeros_like(mask), PIXEL).report()["beta"] is None
