"""What the solver asks of a constitutive law."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol


class LawKind(IntEnum):
    """Which energy the element kernels evaluate; ``coefficients`` are those of simcore.fem.energy."""

    NEO_HOOKEAN = 0
    POLYNOMIAL = 1
    VERONDA_WESTMANN = 2
    HENCKY = 3
    WELLMAN = 4
    SMALL_STRAIN = 5
    ST_VENANT_KIRCHHOFF = 6


@dataclass(frozen=True)
class Law:
    """A constitutive law as numbers: W = W_iso + kappa U(J), U = ((J^2 - 1)/2 - ln J) / 2.

    W_iso is integrated element by element, U with volumes averaged at the nodes, which keeps linear tetrahedra from
    locking. coefficients: of W_iso, kPa or 1. shear, bulk: moduli at small strain, kPa. A law that stiffens keeps this
    bulk modulus: it needs a Poisson's ratio near 0.5 to keep its volume.
    """

    kind: LawKind
    coefficients: tuple[float, ...]
    shear: float
    bulk: float


class ConstitutiveLaw(Protocol):
    """A specification of one law."""

    def law(self) -> Law: ...


def bulk_modulus(shear: float, poissons_ratio: float) -> float:
    """kappa of isotropic elasticity, in the unit of ``shear``."""
    return 2 * shear * (1 + poissons_ratio) / (3 * (1 - 2 * poissons_ratio))


def shear_modulus(youngs_modulus: float, poissons_ratio: float) -> float:
    """mu of isotropic elasticity, in the unit of ``youngs_modulus``."""
    return youngs_modulus / (2 * (1 + poissons_ratio))
