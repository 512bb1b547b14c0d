"""From line integrals to what the detector stores."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange

LARGEST = 40.0
"""exp(-LARGEST) of any open field rounds to 0."""
TERMS = 11
HALVINGS = 6


def pixel_values(
    integrals: NDArray[np.float32], open_field: float, bits: int, out: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """round(open_field mean(exp(-integral))), not above the largest number of ``bits``.

    integrals: float32 (n ny, n nx), dimensionless: n x n rays a pixel. The mean is that of intensities, as a detector
    element adds up what falls on it; the mean path would darken pixels that a border crosses.
    out: uint16 (ny, nx), overwritten and returned. The exponential is accurate to 1e-12 relative to 1.
    """
    if integrals.shape == out.shape:
        _pixel_values(integrals, open_field, float(2**bits - 1), out)
    else:
        _mean_pixel_values(integrals, open_field, float(2**bits - 1), integrals.shape[0] // out.shape[0], out)
    return out


@njit(cache=True)
def attenuation(integral: float) -> float:
    """exp(-integral), integral in [0, LARGEST], by a polynomial of integral / 2^HALVINGS, squared HALVINGS times.

    The exponential of the standard library keeps the loop over pixels from vectorising; this does not."""
    reduced = -integral / 2**HALVINGS
    value = 1.0
    for term in range(TERMS, 0, -1):
        value = 1.0 + value * (reduced * (1.0 / term))  # a constant: divisions took half of the time
    for _ in range(HALVINGS):
        value *= value
    return value


@njit(parallel=True, cache=True, error_model="numpy")
def _pixel_values(integrals: NDArray[np.float32], open_field: float, largest: float, out: NDArray[np.uint16]) -> None:
    ny, nx = integrals.shape
    beside = int(min(open_field * attenuation(0.0) + 0.5, largest))
    for j in prange(ny):
        # Beyond the nipple lies air, more than half of a detector.
        end = nx
        while end > 0 and integrals[j, end - 1] <= np.float32(0.0):
            end -= 1
        for i in range(end):
            integral = min(max(float(integrals[j, i]), 0.0), LARGEST)
            out[j, i] = np.int32(min(open_field * attenuation(integral) + 0.5, largest))
        out[j, end:] = beside


@njit(parallel=True, cache=True, error_model="numpy")
def _mean_pixel_values(
    integrals: NDArray[np.float32], open_field: float, largest: float, rays: int, out: NDArray[np.uint16]
) -> None:
    ny, nx = out.shape
    for j in prange(ny):
        mean = np.zeros(nx)
        for row in range(j * rays, (j + 1) * rays):
            for i in range(nx):
                for column in range(i * rays, (i + 1) * rays):
                    mean[i] += attenuation(min(max(float(integrals[row, column]), 0.0), LARGEST))
        for i in range(nx):
            out[j, i] = int(min(open_field * mean[i] / (rays * rays) + 0.5, largest))
