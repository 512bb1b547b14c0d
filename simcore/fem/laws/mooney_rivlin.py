"""Mooney-Rivlin law."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, InvariantEnergy, Law, bulk_modulus


def derivatives(c: Any, a: float, b: float) -> tuple[float, float, float, float, float]:
    return c[0], c[1], 0.0, 0.0, 0.0


ENERGY = InvariantEnergy("mooney_rivlin", derivatives, stresses=(0, 1))
"""C10 a + C01 b, c = (C10, C01)."""


class MooneyRivlin(Spec):
    """W = C10 (I1 - 3) + C01 (I2 - 3) + kappa U(J), invariants of the isochoric part; mu = 2 (C10 + C01).

    Source: Rivlin, Large elastic deformations of isotropic materials IV, Phil. Trans. R. Soc. A 241 (1948).
    """

    energies: ClassVar[tuple[Energy, ...]] = (ENERGY,)

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
        return Law(ENERGY, (self.c10_kPa, self.c01_kPa), shear, bulk_modulus(shear, self.poissons_ratio))
