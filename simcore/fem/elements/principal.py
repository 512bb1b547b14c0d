"""Element kernel for any isotropic law, in principal axes. Numba kernels.

With the Kirchhoff stress tau_i = dPsi/d eps_i and the moduli gamma_ij = d2Psi/d eps_i d eps_j, Psi = W_iso + p J, the
spatial tangent is
    c = sum_ij (gamma_ij - 2 tau_i delta_ij) n_i n_i n_j n_j
      + sum_{i != j} (tau_i l_j^2 - tau_j l_i^2) / (l_i^2 - l_j^2) (n_i n_j n_i n_j + n_i n_j n_j n_i).
Source: Simo, Numerical analysis and simulation of plasticity, Handbook of Numerical Analysis VI (1998), section 45;
Holzapfel, Nonlinear Solid Mechanics (2000), section 6.6.
"""

from __future__ import annotations

import numpy as np

from simcore.fem.elements.geometry import Array, deformation_gradient, inverse_transpose
from simcore.fem.laws.energies import add_energy_derivatives
from simcore.kernels import njit

_EQUAL = 1e-5
"""Relative difference of squared stretches below which the limit of equal ones is used (error of its square)."""


@njit(cache=True, nogil=True)
def assemble_principal(
    displacement: Array,
    pressure: Array,
    tets: Array,
    gradients: Array,
    volumes: Array,
    numbers: Array,
    coefficients: Array,
    fractions: Array,
    block_of: Array,
    with_tangent: bool,
    force: Array,
    node_volume: Array,
    blocks: Array,
) -> float:
    """As simcore.fem.elements.neo_hookean.assemble_neo_hookean, for a mixture of laws in each element.

    numbers: int64 (laws,), of simcore.fem.laws.energies. coefficients: (laws, COEFFICIENTS), N/mm^2 or 1.
    fractions: (m, laws), shares of the volume.
    """
    force[:] = 0.0
    node_volume[:] = 0.0
    if with_tangent:
        blocks[:] = 0.0
    F, inverse, left, axes = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    squared, tau, gamma = np.empty(3), np.empty(3), np.empty((3, 3))
    q, principal = np.empty((4, 3)), np.empty((4, 3))  # F^-T grad N_a and its components along the axes
    smallest = np.inf
    for e in range(tets.shape[0]):
        tet, gradient, volume = tets[e], gradients[e], volumes[e]
        J = deformation_gradient(displacement, tet, gradient, F)
        smallest = min(smallest, J)
        if not J > 0.0:
            return float(J)
        inverse_transpose(F, J, inverse)
        for i in range(3):
            for j in range(3):
                left[i, j] = F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2]
        principal_axes(left, squared, axes)
        volumetric = J * 0.25 * (pressure[tet[0]] + pressure[tet[1]] + pressure[tet[2]] + pressure[tet[3]])
        tau[:] = volumetric
        gamma[:] = volumetric
        for law in range(numbers.shape[0]):
            if fractions[e, law] > 0.0:
                add_energy_derivatives(numbers[law], coefficients[law], fractions[e, law], squared, J, tau, gamma)
        quarter = 0.25 * volume * J
        for a in range(4):
            for i in range(3):
                q[a, i] = (
                    inverse[i, 0] * gradient[a, 0] + inverse[i, 1] * gradient[a, 1] + inverse[i, 2] * gradient[a, 2]
                )
            for i in range(3):
                principal[a, i] = axes[0, i] * q[a, 0] + axes[1, i] * q[a, 1] + axes[2, i] * q[a, 2]
            node_volume[tet[a]] += quarter
            for i in range(3):
                for k in range(3):
                    force[tet[a], i] += volume * axes[i, k] * tau[k] * principal[a, k]
        if with_tangent:
            _add_tangent(
                volume, quarter, squared, tau, gamma, axes, q, principal,
                block_of[e], blocks,
            )  # fmt: skip
    return float(smallest)


@njit(cache=True, nogil=True)
def _add_tangent(
    volume: float,
    quarter: float,
    squared: Array,
    tau: Array,
    gamma: Array,
    axes: Array,
    q: Array,
    principal: Array,
    block_of: Array,
    blocks: Array,
) -> None:
    shear, local, half = np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            gap = squared[i] - squared[j]
            if abs(gap) > _EQUAL * (squared[i] + squared[j]):
                shear[i, j] = (tau[i] * squared[j] - tau[j] * squared[i]) / gap
            elif i != j:
                shear[i, j] = 0.25 * (gamma[i, i] + gamma[j, j] - 2.0 * gamma[i, j]) - 0.5 * (tau[i] + tau[j])
    k = 0
    for a in range(4):
        for b in range(a, 4):
            block = blocks[block_of[k]]
            k += 1
            pa, pb = principal[a], principal[b]
            initial = tau[0] * pa[0] * pb[0] + tau[1] * pa[1] * pb[1] + tau[2] * pa[2] * pb[2]
            for i in range(3):
                for j in range(3):
                    if i != j:
                        local[i, j] = gamma[i, j] * pa[i] * pb[j] + shear[i, j] * pa[j] * pb[i]
                local[i, i] = initial + (gamma[i, i] - 2.0 * tau[i]) * pa[i] * pb[i]
                for j in range(3):
                    local[i, i] += shear[i, j] * pa[j] * pb[j]
            for i in range(3):
                block[i, 3] += quarter * q[a, i]
                block[3, i] += quarter * q[b, i]
                for j in range(3):
                    half[i, j] = axes[i, 0] * local[0, j] + axes[i, 1] * local[1, j] + axes[i, 2] * local[2, j]
            for i in range(3):
                for j in range(3):
                    block[i, j] += volume * (
                        half[i, 0] * axes[j, 0] + half[i, 1] * axes[j, 1] + half[i, 2] * axes[j, 2]
                    )


@njit(cache=True, nogil=True)
def principal_axes(matrix: Array, values: Array, axes: Array) -> None:
    """Eigenvalues (3,) and eigenvectors (columns of axes (3, 3)) of a symmetric matrix (3, 3), which is overwritten:
    Jacobi's rotations, to rounding."""
    for i in range(3):
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    limit = 1e-34 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]) ** 2
    for _ in range(12):
        if matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2 <= limit:
            break
        for p in range(2):
            for r in range(p + 1, 3):
                if matrix[p, r] == 0.0:
                    continue
                theta = (matrix[r, r] - matrix[p, p]) / (2.0 * matrix[p, r])
                tangent = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    tangent = -tangent
                cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                change = tangent * matrix[p, r]
                matrix[p, p] -= change
                matrix[r, r] += change
                matrix[p, r] = matrix[r, p] = 0.0
                s = 3 - p - r
                x, y = matrix[s, p], matrix[s, r]
                matrix[s, p] = matrix[p, s] = cosine * x - sine * y
                matrix[s, r] = matrix[r, s] = sine * x + cosine * y
                for i in range(3):
                    x, y = axes[i, p], axes[i, r]
                    axes[i, p], axes[i, r] = cosine * x - sine * y, sine * x + cosine * y
    for i in range(3):
        values[i] = matrix[i, i]
