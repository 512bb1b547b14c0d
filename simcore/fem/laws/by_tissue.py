"""A law for each tissue."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from simcore.core.spec_base import Spec
from simcore.core.tissues import Tissue
from simcore.fem.laws.law import Law
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.plain import PlainLaw

FALLBACK = {
    Tissue.AIR: Tissue.SKIN,
    Tissue.GLAND: Tissue.ADIPOSE,
    Tissue.SKIN: Tissue.ADIPOSE,
    Tissue.LIGAMENT: Tissue.ADIPOSE,
    Tissue.MASS: Tissue.GLAND,
    Tissue.CALCIFICATION: Tissue.MASS,
    Tissue.MUSCLE: Tissue.GLAND,
    Tissue.NIPPLE: Tissue.GLAND,
    Tissue.DUCT: Tissue.GLAND,
    Tissue.TDLU: Tissue.GLAND,
    Tissue.ARTERY: Tissue.GLAND,
    Tissue.VEIN: Tissue.GLAND,
}
"""Whose law a tissue takes that has none of its own. The skin carries its stiffness as a membrane, not as a layer that
is thinner than a tetrahedron; air is what the mesh holds beyond the outline."""


def with_fallbacks(laws: dict[Tissue, Law]) -> dict[Tissue, Law]:
    """A law for every label. laws: adipose tissue at least."""
    complete = {}
    for tissue in Tissue:
        named = tissue
        while named not in laws:
            named = FALLBACK[named]
        complete[tissue] = laws[named]
    return complete


class ByTissue(Spec):
    """Every tetrahedron is a mixture of the tissues in it, by volume: the sum of their energies (Voigt's bound)."""

    kind: Literal["by_tissue"] = "by_tissue"
    adipose: PlainLaw
    gland: PlainLaw
    skin: PlainLaw | None = Field(None, description="law of skin voxels; that of adipose tissue where not given")
    ligament: PlainLaw | None = Field(None, description="law of ligaments; that of adipose tissue where not given")
    mass: PlainLaw | None = Field(None, description="law of masses; that of gland where not given")
    calcification: PlainLaw | None = Field(None, description="law of calcifications; that of masses where not given")
    muscle: PlainLaw | None = Field(None, description="law of muscle; that of gland where not given")
    nipple: PlainLaw | None = Field(None, description="law of the nipple; that of gland where not given")
    duct: PlainLaw | None = Field(None, description="law of ducts; that of gland where not given")

    @classmethod
    def example(cls) -> ByTissue:
        """The VICTRE moduli."""
        return cls(
            adipose=NeoHookean(youngs_modulus_kPa=5.0, poissons_ratio=0.49),
            gland=NeoHookean(youngs_modulus_kPa=15.0, poissons_ratio=0.49),
            mass=NeoHookean(youngs_modulus_kPa=20.0, poissons_ratio=0.49),
        )

    def laws(self) -> dict[Tissue, Law]:
        named = {tissue: getattr(self, tissue.name.lower(), None) for tissue in Tissue}
        return with_fallbacks({tissue: spec.law() for tissue, spec in named.items() if spec is not None})
