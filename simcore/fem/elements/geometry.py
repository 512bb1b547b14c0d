"""Geometry of linear tetrahedra: shape gradients, deformation gradient, volume ratio. Numba kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit

Array = NDArray[Any]


@njit(cache=True, nogil=True)
def cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True)
def shape_gradients(nodes: Array, tets: Array) -> tuple[Array, Array]:
    """(gradients (m, 4, 3), 1/mm; volumes (m,), mm^3, positive whatever the orientation)."""
    count = tets.shape[0]
    gradients, volumes = np.empty((count, 4, 3)), np.empty(count)
    edge = np.empty((3, 3))
    for e in range(count):
        for k in range(3):
            for i in range(3):
                edge[k, i] = nodes[tets[e, k + 1], i] - nodes[tets[e, 0], i]
        cross(edge[1], edge[2], gradients[e, 1])
        cross(edge[2], edge[0], gradients[e, 2])
        cross(edge[0], edge[1], gradients[e, 3])
        six_volumes = 0.0
        for i in range(3):
            six_volumes += edge[0, i] * gradients[e, 1, i]
        volumes[e] = abs(six_volumes) / 6
        for i in range(3):
            gradients[e, 0, i] = 0.0
            for k in range(1, 4):
                gradients[e, k, i] /= six_volumes
                gradients[e, 0, i] -= gradients[e, k, i]
    return gradients, volumes


@njit(cache=True, nogil=True)
def deformation_gradient(displacement: Array, tet: Array, gradient: Array, F: Array) -> float:
    """F = 1 + sum u_a (x) grad N_a; returns its determinant."""
    for i in range(3):
        for j in range(3):
            s = 0.0
            for a in range(4):
                s += displacement[tet[a], i] * gradient[a, j]
            F[i, j] = s
        F[i, i] += 1.0
    return float(
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        + F[0, 1] * (F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@njit(cache=True, nogil=True)
def inverse_transpose(F: Array, det: float, out: Array) -> None:
    cross(F[1], F[2], out[0])
    cross(F[2], F[0], out[1])
    cross(F[0], F[1], out[2])
    for i in range(3):
        for j in range(3):
            out[i, j] /= det


@njit(inline="always")
def deformation(displacement: Array, tets: Array, gradients: Array, e: int) -> Any:
    """F of element e, nine numbers row by row, as ``deformation_gradient`` but in registers."""
    first = tets[e, 0]
    x, y, z = displacement[first, 0], displacement[first, 1], displacement[first, 2]
    xx = yy = zz = 1.0
    xy = xz = yx = yz = zx = zy = 0.0
    for a in range(1, 4):
        node = tets[e, a]
        u, v, w = displacement[node, 0] - x, displacement[node, 1] - y, displacement[node, 2] - z
        gx, gy, gz = gradients[e, a, 0], gradients[e, a, 1], gradients[e, a, 2]
        xx, xy, xz = xx + u * gx, xy + u * gy, xz + u * gz
        yx, yy, yz = yx + v * gx, yy + v * gy, yz + v * gz
        zx, zy, zz = zx + w * gx, zy + w * gy, zz + w * gz
    return xx, xy, xz, yx, yy, yz, zx, zy, zz


@njit(inline="always")
def cofactors(F: Any) -> Any:
    """(det F F^-T, nine numbers row by row; det F)"""
    C = (
        F[4] * F[8] - F[5] * F[7], F[5] * F[6] - F[3] * F[8], F[3] * F[7] - F[4] * F[6],
        F[7] * F[2] - F[8] * F[1], F[8] * F[0] - F[6] * F[2], F[6] * F[1] - F[7] * F[0],
        F[1] * F[5] - F[2] * F[4], F[2] * F[3] - F[0] * F[5], F[0] * F[4] - F[1] * F[3],
    )  # fmt: skip
    return C, F[0] * C[0] + F[1] * C[1] + F[2] * C[2]


@njit(cache=True, nogil=True)
def volume_ratios(displacement: Array, tets: Array, gradients: Array) -> Array:
    """det F of each element, (m,)."""
    ratios = np.empty(tets.shape[0])
    for e in range(tets.shape[0]):
        ratios[e] = cofactors(deformation(displacement, tets, gradients, e))[1]
    return ratios


@njit(cache=True, nogil=True)
def keeps_volume(displacement: Array, step: Array, length: float, tets: Array, gradients: Array, share: float) -> bool:
    """Whether det F of every element at displacement + length step is at least ``share`` of what it is before."""
    for e in range(tets.shape[0]):
        F, G = deformation(displacement, tets, gradients, e), deformation(step, tets, gradients, e)
        after = (
            F[0] + length * (G[0] - 1.0), F[1] + length * G[1], F[2] + length * G[2],
            F[3] + length * G[3], F[4] + length * (G[4] - 1.0), F[5] + length * G[5],
            F[6] + length * G[6], F[7] + length * G[7], F[8] + length * (G[8] - 1.0),
        )  # fmt: skip
        if not cofactors(after)[1] >= share * cofactors(F)[1]:
            return False
    return True
