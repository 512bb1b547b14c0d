"""Block-Jacobi: the inverses of the 3x3 diagonal blocks in the free directions. Numba kernels."""

from __future__ import annotations

import numpy as np

from simcore.fem.elements.geometry import Array
from simcore.kernels import njit


@njit(cache=True, nogil=True)
def _invert_symmetric(S: Array, out: Array) -> None:
    c00 = S[1, 1] * S[2, 2] - S[1, 2] * S[2, 1]
    c01 = S[1, 2] * S[2, 0] - S[1, 0] * S[2, 2]
    c02 = S[1, 0] * S[2, 1] - S[1, 1] * S[2, 0]
    det = S[0, 0] * c00 + S[0, 1] * c01 + S[0, 2] * c02
    out[0, 0], out[1, 0], out[2, 0] = c00 / det, c01 / det, c02 / det
    out[0, 1] = (S[0, 2] * S[2, 1] - S[0, 1] * S[2, 2]) / det
    out[1, 1] = (S[0, 0] * S[2, 2] - S[0, 2] * S[2, 0]) / det
    out[2, 1] = (S[0, 1] * S[2, 0] - S[0, 0] * S[2, 1]) / det
    out[0, 2] = (S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]) / det
    out[1, 2] = (S[0, 2] * S[1, 0] - S[0, 0] * S[1, 2]) / det
    out[2, 2] = (S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]) / det


@njit(cache=True, nogil=True)
def invert_diagonal(
    row_start: Array,
    column: Array,
    blocks: Array,
    compliance: Array,
    free: Array,
    gliding: Array,
    normal: Array,
    out: Array,
) -> None:
    """Inverses of the 3x3 diagonal blocks of K + B C^-1 B^T in the free directions, zero in the others: what they
    leave of a vector has no part in the directions that are not free.

    blocks: of simcore.fem.linear.tangent.Tangent. out: float32 (n, 4, 4), the last row and column 0.
    """
    n = row_start.shape[0] - 1
    M = np.zeros((n, 3, 3))
    for a in range(n):
        for k in range(row_start[a], row_start[a + 1]):
            b = column[k]
            for i in range(3):
                for j in range(3):
                    M[a, i, j] += blocks[k, i, 3] * compliance[b] * blocks[k, j, 3]
                    if b == a:
                        M[a, i, j] += blocks[k, i, j]
                    else:
                        M[b, i, j] += blocks[k, 3, i] * compliance[a] * blocks[k, 3, j]
    S = np.empty((3, 3))
    for a in range(n):
        for i in range(3):
            for j in range(3):
                S[i, j] = M[a, i, j] if free[a, i] and free[a, j] else 0.0
            if not free[a, i]:
                S[i, i] = 1.0
        _invert_symmetric(S, M[a])
        for i in range(3):
            if not free[a, i]:
                M[a, i, i] = 0.0
        if gliding[a]:
            _glide(S, free[a], normal, M[a])
        out[a] = 0.0
        out[a, :3, :3] = M[a]


@njit(cache=True, nogil=True)
def _glide(S: Array, free: Array, normal: Array, M: Array) -> None:
    """M = P (P S P + 1 - P)^-1 P, with P the projector on the free directions across the normal."""
    P, T, U = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    square = 0.0
    for i in range(3):
        if free[i]:
            square += normal[i] * normal[i]
    for i in range(3):
        for j in range(3):
            P[i, j] = 0.0
            if free[i] and free[j]:
                P[i, j] = (1.0 if i == j else 0.0) - normal[i] * normal[j] / square
    across = P @ S @ P
    for i in range(3):
        for j in range(3):
            T[i, j] = across[i, j] + ((1.0 if i == j else 0.0) - P[i, j])
    _invert_symmetric(T, U)
    across = P @ U @ P
    for i in range(3):
        for j in range(3):
            M[i, j] = across[i, j]
