"""Neo-Hookean element kernel: internal force, tangent stiffness and volume of linear tetrahedra, total Lagrangian.

Energy: sum over elements of V_e W_iso(F_e) plus sum over nodes of V_a kappa_a U(Jbar_a), where Jbar_a is the volume
ratio averaged over the tetrahedra around node a. With the pressure p_a = kappa_a U'(Jbar_a) as an independent unknown:

    R_a  = sum_e V_e (P_iso + p_e J F^-T) grad N_a,   p_e the mean of the four nodal pressures
    Rp_a = V_a (Jbar_a - J(p_a))

Source: Bonet, Burton, A simple average nodal pressure tetrahedral element, Commun. Numer. Meth. Engng 14 (1998);
Holzapfel, Nonlinear Solid Mechanics (2000), chapter 6, for the isochoric split.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from simcore.fem.element import Array, deformation_gradient, inverse_transpose


@njit(cache=True, nogil=True)
def assemble_neo_hookean(
    displacement: Array,
    pressure: Array,
    tets: Array,
    gradients: Array,
    volumes: Array,
    shear_moduli: Array,
    block_of: Array,
    with_tangent: bool,
    force: Array,
    node_volume: Array,
    stiffness: Array,
    coupling_upper: Array,
    coupling_lower: Array,
) -> float:
    """Internal force and tangent; the last five arguments are overwritten.

    shear_moduli: (m,), N/mm^2.
    force: (n, 3), N. node_volume: (n,) deformed volume around the nodes, mm^3.
    stiffness: (blocks, 3, 3) dR_a/du_b of the upper half. coupling_upper: (blocks, 3) dR_a/dp_b,
    coupling_lower: (blocks, 3) dR_b/dp_a. with_tangent: False leaves these three alone.
    returns: the smallest det F; at the first one that is not positive it stops with that value.
    """
    force[:] = 0.0
    node_volume[:] = 0.0
    if with_tangent:
        stiffness[:] = 0.0
        coupling_upper[:] = 0.0
        coupling_lower[:] = 0.0
    F, inverse = np.empty((3, 3)), np.empty((3, 3))
    f, q = np.empty((4, 3)), np.empty((4, 3))  # F grad N_a and F^-T grad N_a
    smallest = np.inf
    for e in range(tets.shape[0]):
        tet, gradient, volume = tets[e], gradients[e], volumes[e]
        J = deformation_gradient(displacement, tet, gradient, F)
        smallest = min(smallest, J)
        if not J > 0.0:
            return float(J)
        inverse_transpose(F, J, inverse)
        I1 = 0.0
        for i in range(3):
            for j in range(3):
                I1 += F[i, j] * F[i, j]
        for a in range(4):
            for i in range(3):
                f[a, i] = F[i, 0] * gradient[a, 0] + F[i, 1] * gradient[a, 1] + F[i, 2] * gradient[a, 2]
                q[a, i] = (
                    inverse[i, 0] * gradient[a, 0] + inverse[i, 1] * gradient[a, 1] + inverse[i, 2] * gradient[a, 2]
                )
        # W_iso = mu/2 (J^(-2/3) I1 - 3)
        shear = shear_moduli[e] * J ** (-2.0 / 3.0)
        element_pressure = J * 0.25 * (pressure[tet[0]] + pressure[tet[1]] + pressure[tet[2]] + pressure[tet[3]])
        quarter = 0.25 * volume * J
        spherical = element_pressure - shear * I1 / 3.0
        for a in range(4):
            node_volume[tet[a]] += quarter
            for i in range(3):
                force[tet[a], i] += volume * (shear * f[a, i] + spherical * q[a, i])
        if with_tangent:
            _add_tangent(
                volume, shear, I1, element_pressure, quarter, gradient, f, q,
                block_of[e], stiffness, coupling_upper, coupling_lower,
            )  # fmt: skip
    return float(smallest)


@njit(cache=True, nogil=True)
def _add_tangent(
    volume: float,
    shear: float,
    I1: float,
    element_pressure: float,
    quarter: float,
    gradient: Array,
    f: Array,
    q: Array,
    blocks: Array,
    stiffness: Array,
    coupling_upper: Array,
    coupling_lower: Array,
) -> None:
    outer_qq = volume * (2.0 / 9.0 * shear * I1 + element_pressure)
    outer_qq_swapped = volume * (shear * I1 / 3.0 - element_pressure)
    outer_fq = -2.0 / 3.0 * volume * shear
    identity = volume * shear
    k = 0
    for a in range(4):
        for b in range(a, 4):
            block = blocks[k]
            k += 1
            diagonal = identity * (
                gradient[a, 0] * gradient[b, 0] + gradient[a, 1] * gradient[b, 1] + gradient[a, 2] * gradient[b, 2]
            )
            for i in range(3):
                coupling_upper[block, i] += quarter * q[a, i]
                coupling_lower[block, i] += quarter * q[b, i]
                for j in range(3):
                    stiffness[block, i, j] += (
                        outer_qq * q[a, i] * q[b, j]
                        + outer_qq_swapped * q[b, i] * q[a, j]
                        + outer_fq * (f[a, i] * q[b, j] + q[a, i] * f[b, j])
                    )
                stiffness[block, i, i] += diagonal
