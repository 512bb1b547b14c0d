"""Exponential law of Veronda and Westmann."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, InvariantEnergy, Law, bulk_modulus, shear_modulus


def derivatives(c: Any, a: float, b: float) -> tuple[float, float, float, float, float]:
    growth = c[0] * c[1] * math.exp(c[1] * a)
    return growth, -0.5 * c[0] * c[1], c[1] * growth, 0.0, 0.0


ENERGY = InvariantEnergy("veronda_westmann", derivatives, stiffens=True)
"""C (exp(alpha a) - 1) - C alpha/2 b, c = (C, alpha)."""


class VerondaWestmann(Spec):
    """W = C (exp(alpha (I1 - 3)) - 1) - C alpha/2 (I2 - 3) + kappa U(J), invariants of the isochoric part;
    mu = C alpha.

    Source: Veronda, Westmann, Mechanical characterization of skin: finite deformations, J. Biomech. 3 (1970) 111-124.
    """

    energies: ClassVar[tuple[Energy, ...]] = (ENERGY,)

    kind: Literal["veronda_westmann"] = "veronda_westmann"
    youngs_modulus_kPa: float = quantity("Young's modulus at small strain", unit="kPa", gt=0.0, le=5000.0)
    exponent: float = quantity("growth alpha of the stiffness with I1", unit="1", gt=0.0, le=20.0)
    poissons_ratio: float = quantity("Poisson's ratio at small strain", unit="1", default=0.495, ge=0.0, le=0.499)

    @classmethod
    def example(cls) -> VerondaWestmann:
        return cls(youngs_modulus_kPa=20.0, exponent=0.5)

    def law(self) -> Law:
        shear = shear_modulus(self.youngs_modulus_kPa, self.poissons_ratio)
        coefficients = (shear / self.exponent, self.exponent)
        return Law(ENERGY, coefficients, shear, bulk_modulus(shear, self.poissons_ratio))
