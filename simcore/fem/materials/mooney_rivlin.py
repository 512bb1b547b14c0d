"""Mooney-Rivlin law."""

from __future__ import annotations

from typing import Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.materials.law import Law, LawKind, bulk_modulus


class MooneyRivlin(Spec):
    """W = C10 (I1 - 3) + C01 (I2 - 3) + kappa U(J), invariants of the isochoric part; mu = 2 (C10 + C01).

    Source: Rivlin, Large elastic deformations of isotropic materials IV, Phil. Trans. R. Soc. A 241 (1948).
    """

    kind: Literal["mooney_rivlin"] = "mooney_rivlin"
    c10_kPa: float = quantity("coefficient of I1 - 3", unit="kPa", gt=0.0, le=1000.0)
    c01_kPa: float = quantity("coefficient of I2 - 3", unit="kPa", ge=0.0, le=1000.0)
    poissons_ratio: float = quantity("Poisson's ratio at small strain", unit="1", default=0.475, ge=0.0, le=0.499)

    @classmethod
    def example(cls) -> MooneyRivlin:
        """As stiff at small strain as the paper's material, a fifth of it from I2."""
        return cls(c10_kPa=8.218, c01_kPa=2.054)

    def law(self) -> Law:
        shear = 2 * (self.c10_kPa + self.c01_kPa)
        coefficients = (self.c10_kPa, self.c01_kPa, 0.0, 0.0, 0.0)
        return Law(LawKind.POLYNOMIAL, coefficients, shear, bulk_modulus(shear, self.poissons_ratio))
