"""Neo-Hookean law, the paper's."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, InvariantEnergy, Law, bulk_modulus, shear_modulus

PAPER_ALPHA_KPA = 10.1
PAPER_LINEAR_FIT_KPA = 48.6
AlphaReading = Literal["uniaxial", "linear_fit", "equibiaxial"]


def derivatives(c: Any, a: float, b: float) -> tuple[float, float, float, float, float]:
    return c[0] / 2.0, 0.0, 0.0, 0.0, 0.0


ENERGY = InvariantEnergy("neo_hookean", derivatives)
"""mu/2 (I1 - 3), c = (mu,)."""


class NeoHookean(Spec):
    """W = mu/2 (J^(-2/3) I1 - 3) + kappa/2 ((J^2 - 1)/2 - ln J), mu = E / (2 (1 + nu)), kappa = E / (3 (1 - 2 nu)).

    The paper gives alpha = 10.1 kPa in sigma = alpha ((1 + eps)^2 + (1 + eps)^-4). Read as E = 6 alpha = 60.6 kPa it
    comes nearest to the paper's forces; E = 48.6 kPa is the paper's linear fit (Bakic 1998).
    """

    energies: ClassVar[tuple[Energy, ...]] = (ENERGY,)

    kind: Literal["neo_hookean"] = "neo_hookean"
    youngs_modulus_kPa: float = quantity("Young's modulus at small strain", unit="kPa", default=60.6, gt=0.0, le=5000.0)
    poissons_ratio: float = quantity("Poisson's ratio", unit="1", default=0.475, ge=0.0, le=0.499)

    @classmethod
    def example(cls) -> NeoHookean:
        return cls()

    @classmethod
    def paper(cls, reading: AlphaReading = "uniaxial", poissons_ratio: float = 0.475) -> NeoHookean:
        """The paper's material.

        reading: what its alpha = 10.1 kPa means. "uniaxial": alpha = mu/2, E = 6 alpha = 60.6 kPa. "linear_fit": the
        E = 48.6 kPa that the hyperelastic curve replaces. "equibiaxial": the printed form, with a minus sign and
        alpha = mu, is the true stress of an equibiaxial stretch, E = 3 alpha = 30.3 kPa.
        """
        modulus = {
            "uniaxial": 6 * PAPER_ALPHA_KPA,
            "linear_fit": PAPER_LINEAR_FIT_KPA,
            "equibiaxial": 3 * PAPER_ALPHA_KPA,
        }[reading]
        return cls(youngs_modulus_kPa=round(modulus, 9), poissons_ratio=poissons_ratio)

    def law(self) -> Law:
        shear = shear_modulus(self.youngs_modulus_kPa, self.poissons_ratio)
        return Law(ENERGY, (shear,), shear, bulk_modulus(shear, self.poissons_ratio))
