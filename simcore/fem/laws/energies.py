"""The isochoric energies of all laws in logarithms of principal stretches: derivatives for the element kernel. Numba
kernels.

With eps_i = ln lambda_i and the isochoric stretches lb_i = lambda_i J^(-1/3):
    I1 = sum lb_i^2, I2 = sum lb_i^-2, eq = sqrt(2/3 sum (ln lb_i)^2)
What a law makes of them stands in its own file.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.fem.laws.law import Energy, InvariantEnergy, LinearEnergy, LogarithmicEnergy
from simcore.fem.laws.plain import ENERGIES
from simcore.kernels import njit

Array = NDArray[Any]

COEFFICIENTS = 5
"""The most that a law has."""
_SMALLEST_STRAIN = 1e-8
_INVARIANT = [energy for energy in ENERGIES if isinstance(energy, InvariantEnergy)]
_LOGARITHMIC = [energy for energy in ENERGIES if isinstance(energy, LogarithmicEnergy)]
_LINEAR = [energy for energy in ENERGIES if isinstance(energy, LinearEnergy)]
_NUMBERED = (*_INVARIANT, *_LOGARITHMIC, *_LINEAR)
_FIRST_LOGARITHMIC = len(_INVARIANT)


def number_of(energy: Energy) -> int:
    """How the kernels call it."""
    return _NUMBERED.index(energy)


def _chain(energies: Sequence[Energy]) -> Any:
    """(number, *arguments) -> the derivatives of that energy: a compiled chain of questions."""
    own = njit(energies[0].derivatives)
    if len(energies) == 1:

        @njit
        def only(number: int, c: Array, *arguments: float) -> Any:
            return own(c, *arguments)

        return only
    others = _chain(energies[1:])

    @njit
    def chosen(number: int, c: Array, *arguments: float) -> Any:
        if number == 0:
            return own(c, *arguments)
        return others(number - 1, c, *arguments)

    return chosen


_of_invariants = _chain(_INVARIANT)
_of_equivalent_strain = _chain(_LOGARITHMIC)


@njit(cache=True, nogil=True)
def add_energy_derivatives(
    number: int, c: Array, weight: float, squared: Array, J: float, first: Array, second: Array
) -> None:
    """Adds ``weight`` times dW_iso/d eps_i to first (3,) and d2W_iso/d eps_i d eps_j to second (3, 3).

    number: ``number_of`` an energy that is not linear. c: coefficients (COEFFICIENTS,). squared: squares of the
    principal stretches (3,). J: their product's root.
    """
    if number >= _FIRST_LOGARITHMIC:
        _add_logarithmic(number - _FIRST_LOGARITHMIC, c, weight, squared, J, first, second)
        return
    scale = J ** (-2.0 / 3.0)
    I1, I2 = 0.0, 0.0
    for i in range(3):
        I1 += scale * squared[i]
        I2 += 1.0 / (scale * squared[i])
    W1, W2, W11, W12, W22 = _of_invariants(number, c, I1 - 3.0, I2 - 3.0)
    for i in range(3):
        b_i = scale * squared[i]
        slope1_i, slope2_i = 2.0 * (b_i - I1 / 3.0), -2.0 * (1.0 / b_i - I2 / 3.0)
        first[i] += weight * (W1 * slope1_i + W2 * slope2_i)
        for j in range(3):
            b_j = scale * squared[j]
            slope1_j, slope2_j = 2.0 * (b_j - I1 / 3.0), -2.0 * (1.0 / b_j - I2 / 3.0)
            curve1 = 4.0 * (I1 / 9.0 - (b_i + b_j) / 3.0)
            curve2 = 4.0 * (I2 / 9.0 - (1.0 / b_i + 1.0 / b_j) / 3.0)
            if i == j:
                curve1 += 4.0 * b_i
                curve2 += 4.0 / b_i
            second[i, j] += weight * (
                W1 * curve1
                + W2 * curve2
                + W11 * slope1_i * slope1_j
                + W12 * (slope1_i * slope2_j + slope2_i * slope1_j)
                + W22 * slope2_i * slope2_j
            )


@njit(cache=True, nogil=True)
def _add_logarithmic(
    number: int, c: Array, weight: float, squared: Array, J: float, first: Array, second: Array
) -> None:
    strain = np.empty(3)
    mean = np.log(J) / 3.0
    equivalent = 0.0
    for i in range(3):
        strain[i] = 0.5 * np.log(squared[i]) - mean
        equivalent += strain[i] * strain[i]
    equivalent = np.sqrt(2.0 / 3.0 * equivalent)
    secant, slope = _of_equivalent_strain(number, c, equivalent)
    bend = (slope - secant) / (equivalent * equivalent) if equivalent > _SMALLEST_STRAIN else 0.0
    for i in range(3):
        first[i] += weight * 2.0 / 3.0 * secant * strain[i]
        for j in range(3):
            unit = 2.0 / 3.0 if i == j else -1.0 / 3.0
            second[i, j] += weight * (2.0 / 3.0 * secant * unit + 4.0 / 9.0 * bend * strain[i] * strain[j])
