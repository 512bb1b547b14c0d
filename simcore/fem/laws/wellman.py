"""Exponential law of Wellman."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, Law, LogarithmicEnergy, bulk_modulus, shear_modulus

_SMALLEST_STRAIN = 1e-8


def derivatives(c: Any, equivalent: float) -> tuple[float, float]:
    s = 1.0 - math.exp(-equivalent)
    stress = c[0] / c[1] * math.expm1(c[1] * s)
    slope = (c[0] * math.exp(c[1] * s) * (1.0 - s) - stress) * (1.0 - s)
    secant = stress * (1.0 - s) / equivalent if equivalent > _SMALLEST_STRAIN else c[0]
    return secant, slope


ENERGY = LogarithmicEnergy("wellman", derivatives, stiffens=True)
"""f' = E/m (exp(m s) - 1) (1 - s), s = 1 - exp(-eq), c = (E, m). A uniaxial, volume-preserving stretch lambda has
eq = |ln lambda|, so f' / lambda is the nominal stress at the nominal compression s = 1 - lambda."""


class Wellman(Spec):
    """Nominal stress b/m (exp(m s) - 1) at a nominal compression s of a punched sample: Young's modulus b exp(m s).

    In three dimensions the energy is that of the uniaxial test at the equivalent logarithmic strain
    eq = sqrt(2/3) |ln of the isochoric stretches|, s = 1 - exp(-eq), plus kappa U(J).
    Source: Wellman, Tactile imaging, PhD thesis, Harvard University (1999).
    """

    energies: ClassVar[tuple[Energy, ...]] = (ENERGY,)

    kind: Literal["wellman"] = "wellman"
    youngs_modulus_kPa: float = quantity("Young's modulus b at small strain", unit="kPa", gt=0.0, le=5000.0)
    exponent: float = quantity("growth m of the stiffness with nominal compression", unit="1", ge=0.01, le=50.0)
    poissons_ratio: float = quantity("Poisson's ratio at small strain", unit="1", default=0.495, ge=0.0, le=0.499)

    @classmethod
    def example(cls) -> Wellman:
        return cls(youngs_modulus_kPa=5.0, exponent=5.0)

    def law(self) -> Law:
        shear = shear_modulus(self.youngs_modulus_kPa, self.poissons_ratio)
        # 3 mu instead of b, so that b is Young's modulus at any Poisson's ratio.
        return Law(ENERGY, (3 * shear, self.exponent), shear, bulk_modulus(shear, self.poissons_ratio))
