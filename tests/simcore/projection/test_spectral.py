"""The sum over energies of a pixel, against double precision."""

from __future__ import annotations

import numpy as np

from simcore.projection.spectral import spectral_sums


def test_signal_and_variance_are_the_sums_over_energies() -> None:
    rng = np.random.default_rng(1)
    integrals = (rng.random((3, 40, 50)) * np.array([6.0, 3.0, 0.5])[:, None, None]).astype(np.float32)
    curves, weights = rng.random((3, 8)) + 0.1, rng.random((2, 8))
    signal, variance = np.empty((2, 40, 50), np.float32)
    spectral_sums(integrals, curves, weights, signal, variance)
    shares = np.exp(-np.tensordot(curves.T, integrals.astype(np.float64), 1))
    for values, row in zip((signal, variance), weights, strict=True):
        np.testing.assert_allclose(values, np.tensordot(row, shares, 1), rtol=1e-5)


def test_a_pixel_beside_the_breast_has_the_open_field() -> None:
    signal, variance = np.empty((2, 4, 5), np.float32)
    weights = np.array([[1.0, 2.0], [3.0, 4.0]])
    spectral_sums(np.zeros((2, 4, 5), np.float32), np.ones((2, 2)), weights, signal, variance)
    assert np.all(signal == 3.0)
    assert np.all(variance == 7.0)


def test_the_thickest_path_gives_nothing_and_no_overflow() -> None:
    signal, variance = np.empty((2, 1, 1), np.float32)
    spectral_sums(np.full((1, 1, 1), 1e6, np.float32), np.ones((1, 1)), np.ones((2, 1)), signal, variance)
    assert 0.0 <= signal[0, 0] < 1e-16


def test_the_same_bytes_for_any_number_of_threads(threads: object) -> None:
    rng = np.random.default_rng(2)
    integrals = rng.random((3, 64, 300)).astype(np.float32)
    curves, weights = rng.random((3, 8)), rng.random((2, 8))
    outputs = []
    for count in (1, 2):
        threads(count)  # type: ignore[operator]
        signal, variance = np.empty((2, 64, 300), np.float32)
        spectral_sums(integrals, curves, weights, signal, variance)
        outputs.append(signal.tobytes() + variance.tobytes())
    assert outputs[0] == outputs[1]
