"""Element kernel for laws that are linear in a strain: small strain, or St. Venant-Kirchhoff. Numba kernels.

Stress S = 2 mu dev(E) + p 1 with p = kappa tr(E) averaged at the nodes. E is the symmetric gradient of the displacement
(then the geometry stays the undeformed one), or the Green-Lagrange strain (F^T F - 1)/2.
"""

from __future__ import annotations

import numpy as np

from simcore.fem.elements.geometry import Array, deformation_gradient
from simcore.kernels import njit


@njit(cache=True, nogil=True)
def assemble_linear_strain(
    displacement: Array,
    pressure: Array,
    tets: Array,
    gradients: Array,
    volumes: Array,
    shear_moduli: Array,
    large: bool,
    block_of: Array,
    with_tangent: bool,
    force: Array,
    node_volume: Array,
    blocks: Array,
) -> float:
    """As simcore.fem.elements.neo_hookean.assemble_neo_hookean; ``node_volume`` is that of 1 + tr(E) instead of J.

    large: Green-Lagrange strain. returns: 1 (small strain asks nothing of det F), or the smallest det F where large.
    """
    force[:] = 0.0
    node_volume[:] = 0.0
    if with_tangent:
        blocks[:] = 0.0
    F, strain, stress, left = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    f, s = np.empty((4, 3)), np.empty((4, 3))  # F grad N_a and S grad N_a
    smallest = 1.0
    for e in range(tets.shape[0]):
        tet, gradient, volume, mu = tets[e], gradients[e], volumes[e], shear_moduli[e]
        J = deformation_gradient(displacement, tet, gradient, F)
        if large:
            smallest = min(smallest, J)
            if not J > 0.0:
                return float(J)
        for i in range(3):
            for j in range(3):
                if large:
                    strain[i, j] = 0.5 * (F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j])
                else:
                    strain[i, j] = 0.5 * (F[i, j] + F[j, i])
            strain[i, i] -= 0.5 if large else 1.0
        if not large:
            for i in range(3):
                for j in range(3):
                    F[i, j] = 1.0 if i == j else 0.0
        trace = strain[0, 0] + strain[1, 1] + strain[2, 2]
        mean = 0.25 * (pressure[tet[0]] + pressure[tet[1]] + pressure[tet[2]] + pressure[tet[3]])
        for i in range(3):
            for j in range(3):
                stress[i, j] = 2.0 * mu * strain[i, j]
                left[i, j] = F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2]
            stress[i, i] += mean - 2.0 / 3.0 * mu * trace
        for a in range(4):
            node_volume[tet[a]] += 0.25 * volume * (1.0 + trace)
            for i in range(3):
                f[a, i] = F[i, 0] * gradient[a, 0] + F[i, 1] * gradient[a, 1] + F[i, 2] * gradient[a, 2]
                s[a, i] = stress[i, 0] * gradient[a, 0] + stress[i, 1] * gradient[a, 1] + stress[i, 2] * gradient[a, 2]
        for a in range(4):
            for i in range(3):
                force[tet[a], i] += volume * (F[i, 0] * s[a, 0] + F[i, 1] * s[a, 1] + F[i, 2] * s[a, 2])
        if with_tangent:
            _add_tangent(volume, mu, large, gradient, f, s, left, block_of[e], blocks)
    return float(smallest)


@njit(cache=True, nogil=True)
def _add_tangent(
    volume: float,
    mu: float,
    large: bool,
    gradient: Array,
    f: Array,
    s: Array,
    left: Array,
    block_of: Array,
    blocks: Array,
) -> None:
    k = 0
    for a in range(4):
        for b in range(a, 4):
            block = blocks[block_of[k]]
            k += 1
            product, initial = 0.0, 0.0
            for i in range(3):
                product += gradient[a, i] * gradient[b, i]
                initial += gradient[a, i] * s[b, i]
            for i in range(3):
                block[i, 3] += 0.25 * volume * f[a, i]
                block[3, i] += 0.25 * volume * f[b, i]
                for j in range(3):
                    block[i, j] += (
                        volume * mu * (f[b, i] * f[a, j] + product * left[i, j] - 2.0 / 3.0 * f[a, i] * f[b, j])
                    )
                if large:
                    block[i, i] += volume * initial
