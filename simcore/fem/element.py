"""Geometry of linear tetrahedra: shape gradients, deformation gradient, volume ratio. Numba kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

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


@njit(cache=True, nogil=True)
def volume_ratios(displacement: Array, tets: Array, gradients: Array) -> Array:
    """det F of each element, (m,)."""
    F = np.empty((3, 3))
    ratios = np.empty(tets.shape[0])
    for e in range(tets.shape[0]):
        ratios[e] = deformation_gradient(displacement, tets[e], gradients[e], F)
    return ratios
