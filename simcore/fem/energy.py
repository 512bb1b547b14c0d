"""Strain energies in logarithms of principal stretches: first and second derivatives. Numba kernels.

With eps_i = ln lambda_i and the isochoric stretches lb_i = lambda_i J^(-1/3):
    I1 = sum lb_i^2, I2 = sum lb_i^-2, eq = sqrt(2/3 sum (ln lb_i)^2)
    neo-Hookean        mu/2 (I1 - 3)                                                    coefficients (mu,)
    polynomial         C10 a + C01 b + C20 a^2 + C11 a b + C02 b^2, a = I1-3, b = I2-3    (C10, C01, C20, C11, C02)
    Veronda-Westmann   C (exp(alpha a) - 1) - C alpha/2 b                                (C, alpha)
    Hencky             3/2 mu eq^2                                                       (mu,)
    Wellman            f(eq), f' = E/m (exp(m s) - 1) (1 - s), s = 1 - exp(-eq)          (E, m)
A uniaxial, volume-preserving stretch lambda has eq = |ln lambda|, so f' / lambda is the nominal stress at the nominal
compression s = 1 - lambda.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from simcore.fem.element import Array
from simcore.fem.materials.law import LawKind

COEFFICIENTS = 5
_NEO_HOOKEAN = int(LawKind.NEO_HOOKEAN)
_POLYNOMIAL = int(LawKind.POLYNOMIAL)
_VERONDA_WESTMANN = int(LawKind.VERONDA_WESTMANN)
_HENCKY = int(LawKind.HENCKY)
_SMALLEST_STRAIN = 1e-8


@njit(cache=True, nogil=True)
def add_energy_derivatives(
    kind: int, c: Array, weight: float, squared: Array, J: float, first: Array, second: Array
) -> None:
    """Adds ``weight`` times dW_iso/d eps_i to first (3,) and d2W_iso/d eps_i d eps_j to second (3, 3).

    c: coefficients (COEFFICIENTS,). squared: squares of the principal stretches (3,). J: their product's root.
    """
    if kind >= _HENCKY:
        _add_logarithmic(kind, c, weight, squared, J, first, second)
        return
    scale = J ** (-2.0 / 3.0)
    I1, I2 = 0.0, 0.0
    for i in range(3):
        I1 += scale * squared[i]
        I2 += 1.0 / (scale * squared[i])
    W1, W2, W11, W12, W22 = _invariant_derivatives(kind, c, I1 - 3.0, I2 - 3.0)
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
def _invariant_derivatives(kind: int, c: Array, a: float, b: float) -> tuple[float, float, float, float, float]:
    """dW/dI1, dW/dI2, d2W/dI1^2, d2W/dI1dI2, d2W/dI2^2 at a = I1 - 3, b = I2 - 3."""
    if kind == _NEO_HOOKEAN:
        return c[0] / 2.0, 0.0, 0.0, 0.0, 0.0
    if kind == _POLYNOMIAL:
        return (
            c[0] + 2.0 * c[2] * a + c[3] * b,
            c[1] + c[3] * a + 2.0 * c[4] * b,
            2.0 * c[2],
            c[3],
            2.0 * c[4],
        )
    growth = c[0] * c[1] * np.exp(c[1] * a)
    return growth, -0.5 * c[0] * c[1], c[1] * growth, 0.0, 0.0


@njit(cache=True, nogil=True)
def _add_logarithmic(kind: int, c: Array, weight: float, squared: Array, J: float, first: Array, second: Array) -> None:
    strain = np.empty(3)
    mean = np.log(J) / 3.0
    equivalent = 0.0
    for i in range(3):
        strain[i] = 0.5 * np.log(squared[i]) - mean
        equivalent += strain[i] * strain[i]
    equivalent = np.sqrt(2.0 / 3.0 * equivalent)
    secant, slope = 3.0 * c[0], 3.0 * c[0]  # f' / eq and f''
    if kind != _HENCKY:
        s = 1.0 - np.exp(-equivalent)
        stress = c[0] / c[1] * np.expm1(c[1] * s)
        slope = (c[0] * np.exp(c[1] * s) * (1.0 - s) - stress) * (1.0 - s)
        secant = stress * (1.0 - s) / equivalent if equivalent > _SMALLEST_STRAIN else c[0]
    bend = (slope - secant) / (equivalent * equivalent) if equivalent > _SMALLEST_STRAIN else 0.0
    for i in range(3):
        first[i] += weight * 2.0 / 3.0 * secant * strain[i]
        for j in range(3):
            unit = 2.0 / 3.0 if i == j else -1.0 / 3.0
            second[i, j] += weight * (2.0 / 3.0 * secant * unit + 4.0 / 9.0 * bend * strain[i] * strain[j])
