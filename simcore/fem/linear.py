"""Conjugate gradients on the tangent with the pressure condensed: A = K + B C^-1 B^T, C diagonal.

Serial, so that every sum has one order and the result does not depend on the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simcore.fem.constraints import Constraints
from simcore.fem.model import Floats, Pattern
from simcore.fem.preconditioner import invert_diagonal

Array = NDArray[Any]


class Solved(NamedTuple):
    """x: (n, 3). definite: whether A was positive along every direction that was tried."""

    x: Floats
    iterations: int
    definite: bool


@dataclass(frozen=True, eq=False)
class Tangent:
    """The symmetric operator A in upper half storage, single precision (half the memory to stream).

    stiffness: K, (blocks, 3, 3). coupling_upper, coupling_lower: B = dR/dp, (blocks, 3): dR_a/dp_b and dR_b/dp_a.
    compliance: C^-1, (n,).
    """

    pattern: Pattern
    stiffness: NDArray[np.float32]
    coupling_upper: NDArray[np.float32]
    coupling_lower: NDArray[np.float32]
    compliance: Floats

    def apply(self, x: Floats) -> tuple[Floats, Floats]:
        """(A x (n, 3), C^-1 B^T x (n,))."""
        y, t = np.empty_like(x), np.empty(len(x))
        _multiply(*self._arrays, x, t, y)
        return y, t

    def apply_coupling(self, t: Floats) -> Floats:
        """B t, (n, 3)."""
        y = np.zeros((len(t), 3))
        p = self.pattern
        _multiply_coupling(p.row_start, p.column, self.coupling_upper, self.coupling_lower, t, y)
        return y

    def solve(
        self, rhs: Floats, constraints: Constraints, guard: Guard, tolerance: float, max_iterations: int = 4000
    ) -> Solved:
        """x with A x = rhs in the space that the constraints and the guard leave, (n, 3).

        tolerance: on the preconditioned residual, relative to its first value.
        Where A is not positive along a direction it ends with what it has by then.
        """
        preconditioner = np.empty((len(rhs), 3, 3))
        p = self.pattern
        invert_diagonal(
            p.row_start, p.column, self.stiffness, self.coupling_upper, self.coupling_lower,
            self.compliance, constraints.free, constraints.gliding, constraints.normal, preconditioner,
        )  # fmt: skip
        r = rhs.copy()
        constraints.project(r)
        x, iterations, definite = _conjugate_gradients(
            *self._arrays, preconditioner, r, guard.nodes, guard.vectors, tolerance, max_iterations
        )
        return Solved(x, int(iterations), bool(definite))

    @property
    def _arrays(self) -> tuple[Array, ...]:
        p = self.pattern
        return (
            p.row_start, p.column, self.stiffness, self.coupling_upper, self.coupling_lower, self.compliance,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Guard:
    """Constraints vectors^T v_y[nodes] = 0: no drift along y and no roll about x of the chest wall.

    nodes: int64 (w,). vectors: (w, k), orthonormal.
    """

    nodes: NDArray[np.int64]
    vectors: Floats

    @classmethod
    def against_roll(cls, nodes: Floats, wall: NDArray[np.int64]) -> Guard:
        """A wall that is free in its plane lets a tall breast drift and tip over between frictionless plates."""
        z = nodes[wall, 2]
        basis = np.linalg.qr(np.stack([np.ones(len(z)), z - z.mean()], axis=1))[0]
        return cls(np.ascontiguousarray(wall, dtype=np.int64), np.ascontiguousarray(basis))

    @classmethod
    def none(cls) -> Guard:
        """No constraint: for a wall that is held by its nodes."""
        return cls(np.empty(0, np.int64), np.empty((0, 0)))

    def project(self, v: Floats) -> None:
        """Takes the guarded components out of v (n, 3), in place."""
        _project(v, self.nodes, self.vectors)


@njit(cache=True, nogil=True, fastmath=True)
def _multiply(
    row_start: Array,
    column: Array,
    K: Array,
    upper: Array,
    lower: Array,
    compliance: Array,
    x: Array,
    t: Array,
    y: Array,
) -> float:
    """t = C^-1 B^T x, y = K x + B t; returns x . y"""
    n = row_start.shape[0] - 1
    y[:] = 0.0
    t[:] = 0.0
    for a in range(n):
        x0, x1, x2 = x[a, 0], x[a, 1], x[a, 2]
        k = row_start[a]
        s = upper[k, 0] * x0 + upper[k, 1] * x1 + upper[k, 2] * x2
        for k in range(row_start[a] + 1, row_start[a + 1]):
            b = column[k]
            t[b] += upper[k, 0] * x0 + upper[k, 1] * x1 + upper[k, 2] * x2
            s += lower[k, 0] * x[b, 0] + lower[k, 1] * x[b, 1] + lower[k, 2] * x[b, 2]
        t[a] += s
    for a in range(n):
        t[a] *= compliance[a]
    for a in range(n):
        x0, x1, x2, ta = x[a, 0], x[a, 1], x[a, 2], t[a]
        k = row_start[a]
        s0 = K[k, 0, 0] * x0 + K[k, 0, 1] * x1 + K[k, 0, 2] * x2 + upper[k, 0] * ta
        s1 = K[k, 1, 0] * x0 + K[k, 1, 1] * x1 + K[k, 1, 2] * x2 + upper[k, 1] * ta
        s2 = K[k, 2, 0] * x0 + K[k, 2, 1] * x1 + K[k, 2, 2] * x2 + upper[k, 2] * ta
        for k in range(row_start[a] + 1, row_start[a + 1]):
            b = column[k]
            z0, z1, z2, tb = x[b, 0], x[b, 1], x[b, 2], t[b]
            s0 += K[k, 0, 0] * z0 + K[k, 0, 1] * z1 + K[k, 0, 2] * z2 + upper[k, 0] * tb
            s1 += K[k, 1, 0] * z0 + K[k, 1, 1] * z1 + K[k, 1, 2] * z2 + upper[k, 1] * tb
            s2 += K[k, 2, 0] * z0 + K[k, 2, 1] * z1 + K[k, 2, 2] * z2 + upper[k, 2] * tb
            y[b, 0] += K[k, 0, 0] * x0 + K[k, 1, 0] * x1 + K[k, 2, 0] * x2 + lower[k, 0] * ta
            y[b, 1] += K[k, 0, 1] * x0 + K[k, 1, 1] * x1 + K[k, 2, 1] * x2 + lower[k, 1] * ta
            y[b, 2] += K[k, 0, 2] * x0 + K[k, 1, 2] * x1 + K[k, 2, 2] * x2 + lower[k, 2] * ta
        y[a, 0] += s0
        y[a, 1] += s1
        y[a, 2] += s2
    product = 0.0
    for a in range(n):
        product += y[a, 0] * x[a, 0] + y[a, 1] * x[a, 1] + y[a, 2] * x[a, 2]
    return product


@njit(cache=True, nogil=True)
def _multiply_coupling(row_start: Array, column: Array, upper: Array, lower: Array, t: Array, y: Array) -> None:
    """y += B t"""
    for a in range(row_start.shape[0] - 1):
        for k in range(row_start[a], row_start[a + 1]):
            b = column[k]
            for i in range(3):
                y[a, i] += upper[k, i] * t[b]
                if b != a:
                    y[b, i] += lower[k, i] * t[a]


@njit(cache=True, nogil=True)
def _project(v: Array, nodes: Array, vectors: Array) -> None:
    for k in range(vectors.shape[1]):
        s = 0.0
        for w in range(nodes.shape[0]):
            s += vectors[w, k] * v[nodes[w], 1]
        for w in range(nodes.shape[0]):
            v[nodes[w], 1] -= vectors[w, k] * s


@njit(cache=True, nogil=True, fastmath=True)
def _advance(x: Array, r: Array, direction: Array, product: Array, alpha: float) -> None:
    for a in range(r.shape[0]):
        for i in range(3):
            x[a, i] += alpha * direction[a, i]
            r[a, i] -= alpha * product[a, i]


@njit(cache=True, nogil=True, fastmath=True)
def _precondition(M: Array, r: Array, z: Array) -> None:
    for a in range(r.shape[0]):
        for i in range(3):
            z[a, i] = M[a, i, 0] * r[a, 0] + M[a, i, 1] * r[a, 1] + M[a, i, 2] * r[a, 2]


@njit(cache=True, nogil=True, fastmath=True)
def _dot(a: Array, b: Array) -> float:
    s = 0.0
    for k in range(a.shape[0]):
        s += a[k, 0] * b[k, 0] + a[k, 1] * b[k, 1] + a[k, 2] * b[k, 2]
    return s


@njit(cache=True, nogil=True)
def _conjugate_gradients(
    row_start: Array, column: Array, K: Array, upper: Array, lower: Array, compliance: Array,
    M: Array, rhs: Array, guard_nodes: Array, guard_vectors: Array,
    tolerance: float, max_iterations: int,
) -> tuple[Array, int, bool]:  # fmt: skip
    r, z, product = rhs.copy(), np.empty_like(rhs), np.empty_like(rhs)
    x, t = np.zeros_like(rhs), np.empty(rhs.shape[0])
    _project(r, guard_nodes, guard_vectors)
    _precondition(M, r, z)
    _project(z, guard_nodes, guard_vectors)
    direction = z.copy()
    rz = _dot(r, z)
    limit = tolerance * tolerance * rz
    iteration, definite = 0, True
    while iteration < max_iterations and rz > limit:
        curvature = _multiply(row_start, column, K, upper, lower, compliance, direction, t, product)
        iteration += 1
        if not curvature > 0.0:
            definite = False
            if iteration == 1:
                x[:] = z
            break
        _project(product, guard_nodes, guard_vectors)
        _advance(x, r, direction, product, rz / curvature)
        _precondition(M, r, z)
        _project(z, guard_nodes, guard_vectors)
        rz_next = _dot(r, z)
        beta = rz_next / rz
        rz = rz_next
        for a in range(direction.shape[0]):
            for i in range(3):
                direction[a, i] = z[a, i] + beta * direction[a, i]
    return x, iteration, definite
