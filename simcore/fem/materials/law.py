"""What the solver asks of a constitutive law."""

from __future__ import annotations

from typing import Protocol


class ConstitutiveLaw(Protocol):
    """A law splits its energy in two: W = W_iso(C J^(-2/3)) + kappa U(J), U = ((J^2 - 1)/2 - ln J) / 2.

    The first part is integrated element by element (simcore.fem.assembly), the second with volumes averaged at the
    nodes, which keeps linear tetrahedra from locking.
    """

    def moduli(self) -> tuple[float, float]:
        """(shear modulus mu, bulk modulus kappa) at small strain, kPa."""
        ...
