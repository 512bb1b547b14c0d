"""The constitutive laws of the elements, as the kernels take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SolverError
from simcore.fem.laws import neo_hookean
from simcore.fem.laws.energies import COEFFICIENTS, number_of
from simcore.fem.laws.law import Energy, Law, LinearEnergy

N_PER_KPA_MM2 = 1e-3


@dataclass(frozen=True, eq=False)
class ElementLaws:
    """A mixture of laws in every element: the energy is the sum of theirs, weighted with their shares of the volume
    (all see the strain of the element: Voigt's bound, the stiffest mixture).

    energies: of the laws. numbers: int64 (laws,), of simcore.fem.laws.energies. coefficients: (laws, COEFFICIENTS),
    N/mm^2 or 1. fractions: (m, laws), rows sum to 1. shear, bulk: (m,) moduli at small strain, N/mm^2.
    """

    energies: tuple[Energy, ...]
    numbers: NDArray[np.int64]
    coefficients: NDArray[np.float64]
    fractions: NDArray[np.float64]
    shear: NDArray[np.float64]
    bulk: NDArray[np.float64]

    @classmethod
    def of(cls, laws: Sequence[Law], fractions: NDArray[np.float64]) -> ElementLaws:
        """fractions: (m, len(laws)). raises: SolverError, code "mixed-strains" """
        energies = tuple(law.energy for law in laws)
        if len(set(energies)) > 1 and any(isinstance(energy, LinearEnergy) for energy in energies):
            raise SolverError(
                f"laws {', '.join(sorted({energy.name for energy in energies}))} cannot be mixed: small strain and "
                "St. Venant-Kirchhoff only go with their own kind",
                code="mixed-strains",
            )
        coefficients = np.zeros((len(laws), COEFFICIENTS))
        for row, law in zip(coefficients, laws, strict=True):
            row[: len(law.coefficients)] = law.coefficients
            row[list(law.energy.stresses)] *= N_PER_KPA_MM2
        fractions = np.ascontiguousarray(fractions, dtype=np.float64)
        return cls(
            energies=energies,
            numbers=np.array([number_of(energy) for energy in energies], dtype=np.int64),
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
        return all(energy is neo_hookean.ENERGY for energy in self.energies)

    @property
    def linear(self) -> LinearEnergy | None:
        """The one energy of a strain whose trace is the change of volume; None where det F is the ratio of volumes."""
        energy = self.energies[0]
        return energy if isinstance(energy, LinearEnergy) else None

    @property
    def least_stretch(self) -> float:
        """Principal stretch that the laws do not stand; 0 where they stand every one."""
        return max(energy.least_stretch for energy in self.energies)
