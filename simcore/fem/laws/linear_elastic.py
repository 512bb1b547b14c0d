"""Laws linear in a strain: Hencky's for large strain; small strain and St. Venant-Kirchhoff for comparison."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, Law, LinearEnergy, LogarithmicEnergy, bulk_modulus, shear_modulus

ST_VENANT_KIRCHHOFF_STRETCH = 3**-0.5
"""Principal stretch, 0.577, below which St. Venant-Kirchhoff's stress falls while it is compressed further."""


def hencky_derivatives(c: Any, equivalent: float) -> tuple[float, float]:
    return 3.0 * c[0], 3.0 * c[0]


ENERGIES = {
    "hencky": LogarithmicEnergy("hencky", hencky_derivatives, softens=True),
    "small": LinearEnergy("small_strain", None, softens=True),
    "green_lagrange": LinearEnergy(
        "st_venant_kirchhoff", None, softens=True, least_stretch=ST_VENANT_KIRCHHOFF_STRETCH, large=True
    ),
}
"""mu |dev of the strain|^2, c = (mu,); Hencky's is 3/2 mu eq^2."""


class LinearElastic(Spec):
    """Stress linear in a strain measure.

    "hencky": W = mu |dev ln V|^2 + kappa U(J), good at large strain. "small": linear theory on the undeformed shape.
    "green_lagrange": St. Venant-Kirchhoff, W = mu |dev E|^2 + kappa/2 (tr E)^2; refused (outcome "unstable-material")
    where a principal stretch falls below 0.577, its limit point in compression.
    Source: Anand, On H. Hencky's approximate strain-energy function, J. Appl. Mech. 46 (1979).
    """

    energies: ClassVar[tuple[Energy, ...]] = tuple(ENERGIES.values())

    kind: Literal["linear_elastic"] = "linear_elastic"
    strain: Literal["hencky", "small", "green_lagrange"] = Field(
        "hencky", description="hencky: logarithmic, for large strain; small: linear theory; green_lagrange: quadratic"
    )
    youngs_modulus_kPa: float = quantity("Young's modulus", unit="kPa", default=48.6, gt=0.0, le=5000.0)
    poissons_ratio: float = quantity("Poisson's ratio", unit="1", default=0.475, ge=0.0, le=0.499)

    @classmethod
    def example(cls) -> LinearElastic:
        return cls()

    def law(self) -> Law:
        shear = shear_modulus(self.youngs_modulus_kPa, self.poissons_ratio)
        return Law(ENERGIES[self.strain], (shear,), shear, bulk_modulus(shear, self.poissons_ratio))
