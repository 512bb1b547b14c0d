"""Polynomial of second order in the invariants."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, InvariantEnergy, Law, bulk_modulus


def derivatives(c: Any, a: float, b: float) -> tuple[float, float, float, float, float]:
    return (
        c[0] + 2.0 * c[2] * a + c[3] * b,
        c[1] + c[3] * a + 2.0 * c[4] * b,
        2.0 * c[2],
        c[3],
        2.0 * c[4],
    )


ENERGY = InvariantEnergy("polynomial", derivatives, stresses=(0, 1, 2, 3, 4), stiffens=True)
"""C10 a + C01 b + C20 a^2 + C11 a b + C02 b^2, c = (C10, C01, C20, C11, C02)."""


class Polynomial(Spec):
    """W = C10 a + C01 b + C20 a^2 + C11 a b + C02 b^2 + kappa U(J) with a = I1 - 3 and b = I2 - 3 of the isochoric
    part; mu = 2 (C10 + C01).

    Source: Samani, Plewes, A method to measure the hyperelastic parameters of ex vivo breast tissue samples,
    Phys. Med. Biol. 49 (2004) 4395-4405.
    """

    energies: ClassVar[tuple[Energy, ...]] = (ENERGY,)

    kind: Literal["polynomial"] = "polynomial"
    c10_kPa: float = quantity("coefficient of I1 - 3", unit="kPa", gt=0.0, le=1000.0)
    c01_kPa: float = quantity("coefficient of I2 - 3", unit="kPa", ge=0.0, le=1000.0)
    c20_kPa: float = quantity("coefficient of (I1 - 3)^2", unit="kPa", ge=0.0, le=1000.0)
    c11_kPa: float = quantity("coefficient of (I1 - 3)(I2 - 3)", unit="kPa", ge=0.0, le=1000.0)
    c02_kPa: float = quantity("coefficient of (I2 - 3)^2", unit="kPa", ge=0.0, le=1000.0)
    poissons_ratio: float = quantity("Poisson's ratio at small strain", unit="1", default=0.495, ge=0.0, le=0.499)

    @classmethod
    def example(cls) -> Polynomial:
        return cls(c10_kPa=0.5, c01_kPa=0.5, c20_kPa=2.0, c11_kPa=1.0, c02_kPa=2.0)

    def law(self) -> Law:
        shear = 2 * (self.c10_kPa + self.c01_kPa)
        coefficients = (self.c10_kPa, self.c01_kPa, self.c20_kPa, self.c11_kPa, self.c02_kPa)
        return Law(ENERGY, coefficients, shear, bulk_modulus(shear, self.poissons_ratio))
