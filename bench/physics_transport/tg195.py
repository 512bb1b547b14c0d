"""AAPM TG-195 case 3 (mammography and breast tomosynthesis): energy left in the breast, by photon of the source.

I. Sechopoulos et al., "Monte Carlo reference data sets for imaging research", Med. Phys. 42 (2015) 5679, report of AAPM
task group 195, case 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.scatter.bodies import FIRST_VOLUME, MIX, VOLUMES_OF_INTEREST, arc, beam, tg195_setting
from simcore.core.progress import silent
from simcore.physics.spectrum import Emission
from simcore.transport.monte_carlo import imbalance, simulate
from simcore.transport.response import IDEAL, tabulated
from simcore.transport.views import field_of

MO_MO_30 = (
    1.551e-4, 4.691e-4, 1.199e-3, 2.405e-3, 4.263e-3, 6.797e-3, 9.761e-3, 1.314e-2, 1.666e-2, 2.013e-2, 2.349e-2,
    2.666e-2, 2.933e-2, 3.167e-2, 3.365e-2, 3.534e-2, 3.644e-2, 3.741e-2, 3.796e-2, 3.823e-2, 3.445e-1, 3.770e-2,
    3.704e-2, 3.639e-2, 9.200e-2, 2.178e-3, 2.048e-3, 2.043e-3, 2.098e-3, 2.193e-3, 2.327e-3, 2.471e-3, 2.625e-3,
    2.770e-3, 2.907e-3, 3.000e-3, 3.062e-3, 3.058e-3, 2.988e-3, 2.823e-3, 2.575e-3, 2.233e-3, 1.815e-3, 1.290e-3,
    6.696e-4, 4.086e-5,
)  # fmt: skip
"""Photons by 0.5 keV from 7.25 keV on."""


@dataclass(frozen=True)
class Case:
    """A setting of the report: beam, tube angle (degrees), energy in the tissue and in the volumes of interest (eV per
    photon: mean of the codes), and the range of the codes for the tissue."""

    beam: str
    angle: float
    tissue: float
    codes: tuple[float, float]
    volumes: tuple[float, ...]

    @property
    def spectrum(self) -> Emission:
        """The spectrum of the beam."""
        if self.beam == "16.8 keV":
            return beam([16.8])
        return Emission(7.25 + 0.5 * np.arange(len(MO_MO_30)), np.array(MO_MO_30), False)


CASES = (
    Case("16.8 keV", 0, 4697.333, (4691.0, 4700.5), (17.692, 18.070, 17.865, 17.262, 17.768, 5.417, 56.017)),
    Case("16.8 keV", 15, 4577.743, (4565.2, 4588.2), (15.217, 16.836, 16.943, 16.431, 18.370, 5.043, 54.974)),
    Case("Mo/Mo 30 kVp", 0, 4293.433, (4287.4, 4296.8), (16.502, 16.658, 16.814, 16.249, 16.521, 6.041, 50.041)),
    Case("Mo/Mo 30 kVp", 15, 4188.833, (4176.5, 4198.2), (14.390, 15.825, 15.972, 15.445, 17.171, 5.619, 49.022)),
)


@dataclass(frozen=True)
class Outcome:
    """eV per photon with standard errors; relative energy imbalance with its standard error."""

    tissue: float
    tissue_error: float
    volumes: NDArray[np.float64]
    volume_errors: NDArray[np.float64]
    imbalance: float
    imbalance_error: float


def run_case(case: Case, rays: int, seed: int = 1) -> Outcome:
    """Follows ``rays`` rays in the setting of a case."""
    geometry = arc([case.angle])
    sums = simulate(
        tg195_setting(), geometry, case.spectrum, tabulated(IDEAL, None, 30.0),
        rays=rays, grid_mm=10.0, capped=(), seed=seed, purpose="tg195", progress=silent,
    )  # fmt: skip
    energy = sums.deposit[0] * 1e3 / solid_angle(geometry.sources[0], *field_of(geometry, 0))
    places = list(range(FIRST_VOLUME, FIRST_VOLUME + len(VOLUMES_OF_INTEREST)))
    tissue = energy[:, [MIX, *places]].sum(axis=1)
    root = np.sqrt(len(energy))
    missing, deviation = imbalance(sums)
    return Outcome(
        float(tissue.mean()), float(tissue.std(ddof=1) / root),
        energy[:, places].mean(axis=0), energy[:, places].std(axis=0, ddof=1) / root,
        float(missing[0]), float(deviation[0]),
    )  # fmt: skip


def solid_angle(
    source: NDArray[np.float64], first: NDArray[np.float64], rows: NDArray[np.float64], columns: NDArray[np.float64]
) -> float:
    """Of a rectangle in z = 0 seen from the source, sr, by the corners' arctangents."""
    total = 0.0
    for a, sign_a in ((0.0, -1.0), (1.0, 1.0)):
        for b, sign_b in ((0.0, -1.0), (1.0, 1.0)):
            x, y, z = first + a * rows + b * columns - source
            total += sign_a * sign_b * np.arctan2(x * y, abs(z) * np.sqrt(x * x + y * y + z * z))
    return float(abs(total))
