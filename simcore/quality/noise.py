"""Noise power spectrum of repeated or flat images (IEC 62220-1, without its two-dimensional trend of higher order)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.quality.texture import periodogram, ring_average

FloatArray = NDArray[np.float64]


def noise_power(regions: NDArray[np.generic], pixel_mm: float) -> tuple[FloatArray, FloatArray]:
    """Noise power spectrum averaged over regions and directions: (frequency [1/mm], power [mm^2 x unit^2]).

    regions: (count, n, n) of images that would be flat without noise, e.g. differences of two exposures over sqrt(2).
    White noise of variance v has the power v pixel_mm^2 at all frequencies.
    """
    mean = np.mean([periodogram(region, pixel_mm) for region in regions], axis=0)
    return ring_average(np.asarray(mean), pixel_mm)


def detective_quantum_efficiency(
    mtf: NDArray[np.generic], normalised_power: NDArray[np.generic], quanta_per_mm2: float
) -> FloatArray:
    """DQE = MTF^2 / (q NNPS) (IEC 62220-1), in the shape of the frequencies.

    normalised_power: noise power over the square of the mean signal, mm^2. quanta_per_mm2: q, photons that fall in.
    """
    return np.asarray(np.asarray(mtf, np.float64) ** 2 / (quanta_per_mm2 * np.asarray(normalised_power, np.float64)))
