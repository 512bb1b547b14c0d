"""Exact solutions of the neo-Hookean law W = mu/2 (J^(-2/3) I1 - 3) + kappa/2 ((J^2 - 1)/2 - ln J)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from bench.support.bodies import Floats
from simcore.fem.laws.law import Law


def piola_stress(F: Floats, law: Law) -> Floats:
    """First Piola-Kirchhoff stress, kPa. F: (..., 3, 3) deformation gradients."""
    J = np.linalg.det(F)[..., None, None]
    I1 = (F**2).sum(axis=(-2, -1), keepdims=True)
    inverse_transpose = np.linalg.inv(F).swapaxes(-2, -1)
    stress: Floats = (
        law.shear * J ** (-2 / 3) * (F - I1 / 3 * inverse_transpose) + law.bulk / 2 * (J**2 - 1) * inverse_transpose
    )
    return stress


def uniaxial(stretch: float, law: Law) -> tuple[float, float]:
    """(nominal stress, kPa, lateral stretch) of a bar of stretch ``stretch`` with free sides."""

    def lateral_stress(wide: float) -> float:
        return float(piola_stress(np.diag([wide, wide, stretch]), law)[0, 0])

    wide = float(brentq(lateral_stress, 0.5, 3.0, xtol=1e-14))
    return float(piola_stress(np.diag([wide, wide, stretch]), law)[2, 2]), wide


def hertz(radius: float, approach: float, youngs_modulus: float, poissons_ratio: float) -> float:
    """Force of a frictionless sphere on a rigid plane, in the unit of modulus times length squared.

    Source: Hertz (1882); Johnson, Contact Mechanics (1985), equation 4.23.
    """
    return float(4 / 3 * youngs_modulus / (1 - poissons_ratio**2) * np.sqrt(radius) * approach**1.5)
