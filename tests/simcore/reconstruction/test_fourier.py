"""The convolution against scipy's transforms in double precision."""

import numpy as np
import pytest
import scipy.fft

from simcore.reconstruction.filter.filters import padded_length
from simcore.reconstruction.filter.fourier import VALUES_IN_CACHE, convolve_columns, passes_of


def exact(columns, response, length):
    spectrum = scipy.fft.rfft(columns.astype(np.float64), length, axis=0)
    return scipy.fft.irfft(spectrum * response[:, None], length, axis=0)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 8, 30, 288, 320, 324, 375, 1000, 4608, 5000])
def test_every_length(length):
    random = np.random.default_rng(length)
    columns = random.normal(size=(length, 33)).astype(np.float32)
    response = random.random(length // 2 + 1).astype(np.float32)
    out = np.empty_like(columns)
    convolve_columns(columns, response, length, out)
    expected = exact(columns, response, length)
    assert np.abs(out - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("count", [1, 15, 16, 17, 31, 32, 40, 64, 70])
def test_any_number_of_columns_of_wider_arrays(count):
    random = np.random.default_rng(count)
    wide = random.normal(size=(100, 90)).astype(np.float32)
    length = padded_length(100)
    response = random.random(length // 2 + 1).astype(np.float32)
    wider = np.full((100, 99), 7.0, np.float32)
    convolve_columns(wide[:, 3 : 3 + count], response, length, wider[:, 5 : 5 + count])
    expected = exact(wide[:, 3 : 3 + count], response, length)[:100]
    assert np.abs(wider[:, 5 : 5 + count] - expected).max() < 1e-6 * np.abs(expected).max()
    assert np.all(wider[:, :5] == 7.0)
    assert np.all(wider[:, 5 + count :] == 7.0)


def test_the_filter_of_one_column_leaves_its_partner_alone():
    """Two columns share a transform."""
    columns = np.zeros((50, 32), np.float32)
    columns[10, 3] = columns[20, 20] = 1.0
    out = np.empty_like(columns)
    convolve_columns(columns, np.linspace(1.0, 2.0, 51, dtype=np.float32), 100, out)
    assert np.abs(np.delete(out, [3, 20], axis=1)).max() < 1e-7
    assert out[10, 3] == pytest.approx(out[20, 20], abs=1e-6)
    assert out[10, 3] > 1.0


def test_passes():
    assert passes_of(4608).radices.tolist() == [4, 4, 4, 4, 2, 3, 3]
    assert sorted(passes_of(360).order) == list(range(360))
    assert VALUES_IN_CACHE < 4608
    with pytest.raises(ValueError, match="14 values"):
        passes_of(14)
