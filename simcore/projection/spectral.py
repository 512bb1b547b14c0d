"""Signal and variance of every pixel of a view: integrals of basis maps, plates and distance, over all energies."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.kernels import njit, prange

LARGEST = 40.0
"""exp(-LARGEST) of any open field is nothing."""
TERMS = 8
HALVINGS = 6


class Beam(NamedTuple):
    """What a projection has to know of tube, materials and detector, at a few energies.

    energies_keV: (energies,), keV.
    curves:  (maps, energies), attenuation of each basis map at each energy.
    plates:  (energies,), line integral along z of all plates in the beam.
    weights: (2, energies), absorbed energy a photon of the source (keV), and its square with what the detector adds to
        the noise (keV2), of a photon perpendicular to the detector.
    cosines, absorption: (angles,), ascending cosines of the angle of incidence, and what the detector absorbs there
        relative to perpendicular photons.
    """

    energies_keV: NDArray[np.float64]
    curves: NDArray[np.float64]
    plates: NDArray[np.float64]
    weights: NDArray[np.float64]
    cosines: NDArray[np.float64]
    absorption: NDArray[np.float64]


def pixel_sums(
    integrals: NDArray[np.float32],
    beam: Beam,
    geometry: AcquisitionGeometry,
    view: int,
    signal: NDArray[np.float32],
    variance: NDArray[np.float32],
) -> None:
    """Mean signal and variance of every pixel for one photon that the source sends into a steradian.

    integrals: float32 (maps, ny, nx), of ``simcore.projection.integrals.basis_integrals``.
    signal, variance: float32 (ny, nx), overwritten: keV sr and keV2 sr. The exponents are taken within 0 and 40; an
        exponential is right to 1e-5.
    """
    pixel = geometry.detector.pixel
    _sums(
        integrals,
        *(array.astype(np.float32) for array in (beam.curves, beam.plates, beam.weights)),
        beam.cosines,
        beam.absorption,
        geometry.pixel_position(view, 0, 0) - geometry.sources[view],
        geometry.detector_frame(view)[1] * pixel,
        geometry.column_direction(view) * pixel,
        geometry.normal(view) * pixel**2,
        signal,
        variance,
    )


@njit(parallel=True, cache=True, fastmath=True, error_model="numpy")
def _sums(
    integrals: NDArray[np.float32],
    curves: NDArray[np.float32],
    plates: NDArray[np.float32],
    weights: NDArray[np.float32],
    cosines: NDArray[np.float64],
    absorption: NDArray[np.float64],
    first_ray: NDArray[np.float64],
    row_step: NDArray[np.float64],
    column_step: NDArray[np.float64],
    area: NDArray[np.float64],
    signal: NDArray[np.float32],
    variance: NDArray[np.float32],
) -> None:
    maps, ny, nx = integrals.shape
    size = math.sqrt(area[0] ** 2 + area[1] ** 2 + area[2] ** 2)
    for j in prange(ny):
        exponents, stretch, solid = np.empty(nx, np.float32), np.empty(nx, np.float32), np.empty(nx, np.float32)
        for i in range(nx):
            x = first_ray[0] + j * row_step[0] + i * column_step[0]
            y = first_ray[1] + j * row_step[1] + i * column_step[1]
            z = first_ray[2] + j * row_step[2] + i * column_step[2]
            length = math.sqrt(x * x + y * y + z * z)
            stretch[i] = length / abs(z)
            facing = abs(x * area[0] + y * area[1] + z * area[2])
            solid[i] = facing / length**3 * np.interp(facing / (length * size), cosines, absorption)
        signal[j, :] = np.float32(0.0)
        variance[j, :] = np.float32(0.0)
        for n in range(plates.size):
            for i in range(nx):
                exponents[i] = stretch[i] * plates[n]
            for k in range(maps):
                curve = curves[k, n]
                for i in range(nx):
                    exponents[i] += integrals[k, j, i] * curve
            of_signal, of_variance = weights[0, n], weights[1, n]
            for i in range(nx):
                share = transmission(min(max(exponents[i], np.float32(0.0)), np.float32(LARGEST)))
                signal[j, i] += of_signal * share
                variance[j, i] += of_variance * share
        for i in range(nx):
            signal[j, i] *= solid[i]
            variance[j, i] *= solid[i]


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
