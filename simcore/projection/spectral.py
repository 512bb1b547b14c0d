"""Signal and variance of a pixel from line integrals of basis maps, summed over energies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange

LARGEST = 40.0
"""exp(-LARGEST) of any open field is nothing."""
TERMS = 8
HALVINGS = 6


def spectral_sums(
    integrals: NDArray[np.float32],
    curves: NDArray[np.float64],
    weights: NDArray[np.float64],
    signal: NDArray[np.float32],
    variance: NDArray[np.float32],
) -> None:
    """sum over n of weights[., n] exp(-sum over k of integrals[k] curves[k, n]), for the signal and for its variance.

    integrals: float32 (maps, ny, nx), such as of ``simcore.projection.integrals.basis_integrals``.
    curves: (maps, energies), attenuation of each map at each energy; with the integrals dimensionless.
    weights: (2, energies), of the signal and of its variance, any units.
    signal, variance: float32 (ny, nx), overwritten, in the units of the weights. Exponents are taken within 0 and 40;
        relative error of an exponential below 1e-5 where it matters (exponents below 20).
    """
    single = curves.astype(np.float32), weights.astype(np.float32)
    _sums(integrals, *single, signal, variance)


@njit(parallel=True, cache=True, fastmath=True, error_model="numpy")
def _sums(
    integrals: NDArray[np.float32],
    curves: NDArray[np.float32],
    weights: NDArray[np.float32],
    signal: NDArray[np.float32],
    variance: NDArray[np.float32],
) -> None:
    maps, ny, nx = integrals.shape
    for j in prange(ny):
        exponents = np.empty(nx, np.float32)
        signal[j, :] = np.float32(0.0)
        variance[j, :] = np.float32(0.0)
        for n in range(curves.shape[1]):
            exponents[:] = np.float32(0.0)
            for k in range(maps):
                curve = curves[k, n]
                for i in range(nx):
                    exponents[i] += integrals[k, j, i] * curve
            of_signal, of_variance = weights[0, n], weights[1, n]
            for i in range(nx):
                share = transmission(min(max(exponents[i], np.float32(0.0)), np.float32(LARGEST)))
                signal[j, i] += of_signal * share
                variance[j, i] += of_variance * share


@njit(cache=True, fastmath=True)
def transmission(exponent: np.float32) -> np.float32:
    """exp(-exponent) in single precision, exponent in [0, LARGEST]: the polynomial of a 64th part, squared six times,
    which vectorises where the standard library's does not."""
    reduced = exponent * np.float32(-1.0 / 2**HALVINGS)
    value = np.float32(1.0)
    for term in range(TERMS, 0, -1):
        value = np.float32(1.0) + value * (reduced * np.float32(1.0 / term))
    for _ in range(HALVINGS):
        value *= value
    return value
