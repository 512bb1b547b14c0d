"""The constitutive laws of the elements, as the kernels take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SolverError
from simcore.fem.energy import COEFFICIENTS
from simcore.fem.materials.law import Law, LawKind

N_PER_KPA_MM2 = 1e-3
_STRESS_LIKE = {
    LawKind.NEO_HOOKEAN: [0],
    LawKind.POLYNOMIAL: [0, 1, 2, 3, 4],
    LawKind.VERONDA_WESTMANN: [0],
    LawKind.HENCKY: [0],
    LawKind.WELLMAN: [0],
    LawKind.SMALL_STRAIN: [0],
    LawKind.ST_VENANT_KIRCHHOFF: [0],
}
"""Which coefficients are stresses (kPa to N/mm^2); the others are pure numbers."""
_LINEAR = (LawKind.SMALL_STRAIN, LawKind.ST_VENANT_KIRCHHOFF)


@dataclass(frozen=True, eq=False)
class ElementLaws:
    """A mixture of laws in every element: the energy is the sum of theirs, weighted with their shares of the volume
    (all see the strain of the element: Voigt's bound, the stiffest mixture).

    kinds: int64 (laws,). coefficients: (laws, COEFFICIENTS), N/mm^2 or 1. fractions: (m, laws), rows sum to 1.
    shear, bulk: (m,) moduli at small strain, N/mm^2.
    """

    kinds: NDArray[np.int64]
    coefficients: NDArray[np.float64]
    fractions: NDArray[np.float64]
    shear: NDArray[np.float64]
    bulk: NDArray[np.float64]

    @classmethod
    def of(cls, laws: Sequence[Law], fractions: NDArray[np.float64]) -> ElementLaws:
        """fractions: (m, len(laws)). raises: SolverError, code "mixed-strains" """
        kinds = {law.kind for law in laws}
        if len(kinds) > 1 and kinds & set(_LINEAR):
            raise SolverError(
                f"laws {', '.join(sorted(k.name.lower() for k in kinds))} cannot be mixed: small strain and "
                "St. Venant-Kirchhoff only go with their own kind",
                code="mixed-strains",
            )
        coefficients = np.zeros((len(laws), COEFFICIENTS))
        for row, law in zip(coefficients, laws, strict=True):
            row[: len(law.coefficients)] = law.coefficients
            row[_STRESS_LIKE[law.kind]] *= N_PER_KPA_MM2
        fractions = np.ascontiguousarray(fractions, dtype=np.float64)
        return cls(
            kinds=np.array([law.kind for law in laws], dtype=np.int64),
            coefficients=coefficients,
            fractions=fractions,
            shear=fractions @ np.array([law.shear for law in laws]) * N_PER_KPA_MM2,
            bulk=fractions @ np.array([law.bulk for law in laws]) * N_PER_KPA_MM2,
        )

    @classmethod
    def homogeneous(cls, law: Law, count: int) -> ElementLaws:
        """``law`` in ``count`` elements."""
        return cls.of([law], np.ones((count, 1)))

    @property
    def neo_hookean(self) -> bool:
        """Whether the shear moduli say it all (a mixture of neo-Hookean laws is one again)."""
        return bool((self.kinds == LawKind.NEO_HOOKEAN).all())

    @property
    def linear_strain(self) -> bool:
        """Whether the volume enters by the trace of a strain instead of det F."""
        return bool(np.isin(self.kinds, _LINEAR).all())

    @property
    def st_venant_kirchhoff(self) -> bool:
        return bool((self.kinds == LawKind.ST_VENANT_KIRCHHOFF).all())
