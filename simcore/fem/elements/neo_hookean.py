"""Neo-Hookean element kernel: internal force, tangent stiffness and volume of linear tetrahedra, total Lagrangian.

Energy: sum over elements of V_e W_iso(F_e) plus sum over nodes of V_a kappa_a U(Jbar_a), where Jbar_a is the volume
ratio averaged over the tetrahedra around node a. With the pressure p_a = kappa_a U'(Jbar_a) as an independent unknown:

    R_a  = sum_e V_e (P_iso + p_e J F^-T) grad N_a,   p_e the mean of the four nodal pressures
    Rp_a = V_a (Jbar_a - J(p_a))

Source: Bonet, Burton, A simple average nodal pressure tetrahedral element, Commun. Numer. Meth. Engng 14 (1998);
Holzapfel, Nonlinear Solid Mechanics (2000), chapter 6, for the isochoric split.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simcore.fem.blocks import add, in_columns, in_rows, on_diagonal, row_of
from simcore.fem.elements.geometry import Array, cofactors, deformation
from simcore.kernels import njit
from simcore.simd.vector import fma, plus, times


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
    blocks: Array,
) -> float:
    """Internal force and tangent; the last three arguments are overwritten.

    shear_moduli: (m,), N/mm^2.
    force: (n, 3), N. node_volume: (n,) deformed volume around the nodes, mm^3.
    blocks: of simcore.fem.elements.model.System. with_tangent: False leaves them alone.
    returns: the smallest det F; at the first one that is not positive it stops with that value.
    """
    force[:] = 0.0
    node_volume[:] = 0.0
    if with_tangent:
        blocks[:] = 0.0
    smallest = np.inf
    for e in range(tets.shape[0]):
        volume = volumes[e]
        F = deformation(displacement, tets, gradients, e)
        C, J = cofactors(F)
        smallest = min(smallest, J)
        if not J > 0.0:
            return float(J)
        I1 = F[0] * F[0] + F[1] * F[1] + F[2] * F[2] + F[3] * F[3] + F[4] * F[4] + F[5] * F[5]
        I1 += F[6] * F[6] + F[7] * F[7] + F[8] * F[8]
        # W_iso = mu/2 (J^(-2/3) I1 - 3)
        shear = shear_moduli[e] * J ** (-2.0 / 3.0)
        mean = 0.25 * (pressure[tets[e, 0]] + pressure[tets[e, 1]] + pressure[tets[e, 2]] + pressure[tets[e, 3]])
        spherical = mean - shear * I1 / (3.0 * J)
        quarter = 0.25 * volume * J
        # F grad N_a and J F^-T grad N_a; those of node 0 are minus the others' sum.
        f1, f2, f3 = _applied(F, gradients, e, 1), _applied(F, gradients, e, 2), _applied(F, gradients, e, 3)
        q1, q2, q3 = _applied(C, gradients, e, 1), _applied(C, gradients, e, 2), _applied(C, gradients, e, 3)
        f0, q0 = _minus_sum(f1, f2, f3), _minus_sum(q1, q2, q3)
        _add_force(force, tets[e, 0], volume * shear, f0, volume * spherical, q0)
        _add_force(force, tets[e, 1], volume * shear, f1, volume * spherical, q1)
        _add_force(force, tets[e, 2], volume * shear, f2, volume * spherical, q2)
        _add_force(force, tets[e, 3], volume * shear, f3, volume * spherical, q3)
        for a in range(4):
            node_volume[tets[e, a]] += quarter
        if with_tangent:
            of_element = (volume, shear, I1, mean, J)
            n0, n1 = _node(blocks, of_element, f0, q0), _node(blocks, of_element, f1, q1)
            n2, n3 = _node(blocks, of_element, f2, q2), _node(blocks, of_element, f3, q3)
            stiff = volume * shear
            _add_block(blocks, block_of[e, 0], n0, n0, stiff * _product(gradients, e, 0, 0))
            _add_block(blocks, block_of[e, 1], n0, n1, stiff * _product(gradients, e, 0, 1))
            _add_block(blocks, block_of[e, 2], n0, n2, stiff * _product(gradients, e, 0, 2))
            _add_block(blocks, block_of[e, 3], n0, n3, stiff * _product(gradients, e, 0, 3))
            _add_block(blocks, block_of[e, 4], n1, n1, stiff * _product(gradients, e, 1, 1))
            _add_block(blocks, block_of[e, 5], n1, n2, stiff * _product(gradients, e, 1, 2))
            _add_block(blocks, block_of[e, 6], n1, n3, stiff * _product(gradients, e, 1, 3))
            _add_block(blocks, block_of[e, 7], n2, n2, stiff * _product(gradients, e, 2, 2))
            _add_block(blocks, block_of[e, 8], n2, n3, stiff * _product(gradients, e, 2, 3))
            _add_block(blocks, block_of[e, 9], n3, n3, stiff * _product(gradients, e, 3, 3))
    return float(smallest)


@njit(inline="always")
def _applied(M: Any, gradients: Array, e: int, a: int) -> Any:
    """M grad N_a, three numbers; M: nine, row by row."""
    x, y, z = gradients[e, a, 0], gradients[e, a, 1], gradients[e, a, 2]
    return (
        M[0] * x + M[1] * y + M[2] * z,
        M[3] * x + M[4] * y + M[5] * z,
        M[6] * x + M[7] * y + M[8] * z,
    )


@njit(inline="always")
def _minus_sum(a: Any, b: Any, c: Any) -> Any:
    return -(a[0] + b[0] + c[0]), -(a[1] + b[1] + c[1]), -(a[2] + b[2] + c[2])


@njit(inline="always")
def _add_force(force: Array, node: int, along_f: float, f: Any, along_q: float, q: Any) -> None:
    for i in range(3):
        force[node, i] += along_f * f[i] + along_q * q[i]


@njit(inline="always")
def _product(gradients: Array, e: int, a: int, b: int) -> Any:
    return (
        gradients[e, a, 0] * gradients[e, b, 0]
        + gradients[e, a, 1] * gradients[e, b, 1]
        + gradients[e, a, 2] * gradients[e, b, 2]
    )


@njit(inline="always")
def _node(blocks: Array, of_element: Any, f: Any, q: Any) -> Any:
    """What a node brings to its blocks: rows (four numbers) that ``_add_block`` multiplies.

    dR_a/du_b = q_a (x) (c1 q_b + c3 f_b) + c2 q_b (x) q_a + f_a (x) c3 q_b + (V mu J^(-2/3) grad N_a . grad N_b) 1, and
    the fourth components make the last column V J q_a / 4 and the last row V J q_b / 4.
    """
    volume, shear, I1, mean, J = of_element
    to_unit = 1.0 / J
    qx, qy, qz = to_unit * q[0], to_unit * q[1], to_unit * q[2]
    c1 = volume * (2.0 / 9.0 * shear * I1 + J * mean)
    c2 = volume * (shear * I1 / 3.0 - J * mean)
    c3 = -2.0 / 3.0 * volume * shear
    quarter = 0.25 * volume * J
    return (
        row_of(blocks, qx, qy, qz, 0.0),
        row_of(blocks, c1 * qx + c3 * f[0], c1 * qy + c3 * f[1], c1 * qz + c3 * f[2], quarter),
        row_of(blocks, c2 * qx, c2 * qy, c2 * qz, 0.0),
        row_of(blocks, f[0], f[1], f[2], quarter / c3),
        row_of(blocks, c3 * qx, c3 * qy, c3 * qz, 0.0),
    )


@njit(inline="always")
def _add_block(blocks: Array, k: int, one: Any, other: Any, diagonal: float) -> None:
    block = times(in_columns(one[0]), in_rows(other[1]))
    block = fma(in_columns(other[2]), in_rows(one[0]), block)
    block = fma(in_columns(one[3]), in_rows(other[4]), block)
    add(blocks, k, plus(on_diagonal(row_of(blocks, diagonal, diagonal, diagonal, 0.0)), block))
