"""What the solver asks of a constitutive law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol


@dataclass(frozen=True)
class Energy:
    """The isochoric strain energy of a law, as its element kernel takes it.

    name: of the law. derivatives: plain Python of numbers, which the kernels compile, see the form; c are the
    coefficients. stresses: indices of the coefficients that are stresses (kPa), the others are pure numbers.
    softens, stiffens: under compression. least_stretch: a principal stretch that the law does not stand.
    """

    name: str
    derivatives: Callable[..., Any] | None
    stresses: tuple[int, ...] = (0,)
    softens: bool = False
    stiffens: bool = False
    least_stretch: float = 0.0

    form: ClassVar[str] = ""


@dataclass(frozen=True)
class InvariantEnergy(Energy):
    """Of the isochoric invariants. derivatives(c, a, b): dW/dI1, dW/dI2, d2W/dI1^2, d2W/dI1dI2, d2W/dI2^2 at
    a = I1 - 3, b = I2 - 3."""

    form: ClassVar[str] = "invariants"


@dataclass(frozen=True)
class LogarithmicEnergy(Energy):
    """f(eq), eq = sqrt(2/3) |ln of the isochoric stretches|. derivatives(c, eq): f'/eq and f''."""

    form: ClassVar[str] = "logarithmic"


@dataclass(frozen=True)
class LinearEnergy(Energy):
    """mu |dev E|^2 of a strain E that is not one of principal stretches alone; an element kernel of its own. large:
    of the Green-Lagrange strain, else of the symmetric gradient of the displacement."""

    large: bool = False

    form: ClassVar[str] = "linear"


@dataclass(frozen=True)
class Law:
    """A constitutive law as numbers: W = W_iso + kappa U(J), U = ((J^2 - 1)/2 - ln J) / 2.

    W_iso is integrated element by element, U with volumes averaged at the nodes, which keeps linear tetrahedra from
    locking. coefficients: of W_iso, kPa or 1. shear, bulk: moduli at small strain, kPa. A law that stiffens keeps this
    bulk modulus: it needs a Poisson's ratio near 0.5 to keep its volume.
    """

    energy: Energy
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
