"""Conjugate gradients on the tangent with the pressure condensed: A = K + B C^-1 B^T, C diagonal.

Serial, so that every sum has one order and the result does not depend on the number of threads. The limit is memory: a
product reads 96 bytes a block (the block, and its part of B a second time), 4.5 ns at the 20 GB/s of one core.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simcore.fem.blocks import (
    Singles,
    add,
    block_at,
    empty,
    in_columns,
    in_rows,
    put,
    row_at,
    row_of,
    sum_of_columns,
    sum_of_rows,
    times,
    times_plus,
)
from simcore.fem.constraints import Constraints
from simcore.fem.model import Floats, Pattern, System
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

    blocks: float32 (blocks, 4, 4) of [[K, B], [B^T, 0]]: K = dR_a/du_b, the last column dR_a/dp_b, the last row
    dR_b/dp_a. coupling: float32 (blocks, 2, 4), these two again. compliance: C^-1, float32 (n,).
    """

    pattern: Pattern
    blocks: Singles
    coupling: Singles
    compliance: Singles

    @classmethod
    def of(cls, pattern: Pattern, system: System, compliance: Floats) -> Tangent:
        """system: in single precision; its blocks are used, not copied. compliance: C^-1, (n,)."""
        coupling = empty(len(pattern.column), 2, 4)
        _copy_coupling(system.blocks, coupling)
        return cls(pattern, system.blocks, coupling, compliance.astype(np.float32))

    def apply(self, x: Floats) -> tuple[Floats, Floats]:
        """(A x (n, 3), C^-1 B^T x (n,))."""
        wide, product = _wide(x), empty(len(x), 4)
        _multiply(*self._arrays, wide, product)
        return product[:, :3].astype(np.float64), product[:, 3].astype(np.float64)

    def apply_coupling(self, t: Floats) -> Floats:
        """B t, (n, 3)."""
        y = _wide(np.zeros((len(t), 3)))
        y[:, 3] = t
        _add_coupling(self.pattern.row_start, self.pattern.column, self.coupling, y)
        return y[:, :3].astype(np.float64)

    def solve(
        self, rhs: Floats, constraints: Constraints, guard: Guard, tolerance: float, max_iterations: int = 4000
    ) -> Solved:
        """x with A x = rhs in the space that the constraints and the guard leave, (n, 3).

        tolerance: on the preconditioned residual, relative to its first value.
        Where A is not positive along a direction it ends with what it has by then.
        """
        preconditioner = empty(len(rhs), 4, 4)
        p = self.pattern
        invert_diagonal(
            p.row_start, p.column, self.blocks, self.compliance,
            constraints.free, constraints.gliding, constraints.normal, preconditioner,
        )  # fmt: skip
        r = rhs.copy()
        constraints.project(r)
        # Products of single precision overflow and vanish for forces far from 1.
        scale = float(np.abs(r).max(initial=0.0)) or 1.0
        x, iterations, definite = _conjugate_gradients(
            *self._arrays, preconditioner, _wide(r / scale), guard.nodes, guard.vectors, tolerance, max_iterations
        )
        return Solved(x[:, :3] * scale, int(iterations), bool(definite))

    @property
    def _arrays(self) -> tuple[Array, ...]:
        return self.pattern.row_start, self.pattern.column, self.blocks, self.coupling, self.compliance


def _wide(x: Floats) -> Singles:
    """(n, 4) float32, the last component 0, of x (n, 3)."""
    wide = empty(len(x), 4)
    wide[:, :3] = x
    wide[:, 3] = 0.0
    return wide


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


@njit(cache=True, nogil=True)
def _copy_coupling(blocks: Array, coupling: Array) -> None:
    for k in range(blocks.shape[0]):
        for i in range(3):
            coupling[k, 0, i] = blocks[k, i, 3]
            coupling[k, 1, i] = blocks[k, 3, i]
        coupling[k, 0, 3] = coupling[k, 1, 3] = 0.0


@njit(cache=True, nogil=True)
def _multiply(
    row_start: Array, column: Array, blocks: Array, coupling: Array, compliance: Array, x: Array, y: Array
) -> None:
    """y = (A x, C^-1 B^T x). x, y: (n, 4), the last component of x is 0."""
    y[:] = 0.0
    for a in range(row_start.shape[0] - 1):
        diagonal = row_start[a]
        from_here = in_columns(row_at(x, a))
        here = times(block_at(blocks, diagonal), in_rows(row_at(x, a)))
        for k in range(diagonal + 1, row_start[a + 1]):
            b = column[k]
            block = block_at(blocks, k)
            here = times_plus(block, in_rows(row_at(x, b)), here)
            add(y, b, sum_of_rows(times(block, from_here)))
        add(y, a, sum_of_columns(here))
        y[a, 3] *= compliance[a]
    _add_coupling(row_start, column, coupling, y)


@njit(cache=True, nogil=True)
def _four_times(y: Array, a: int) -> Any:
    """The row of four times y[a, 3]."""
    t = y[a, 3]
    return row_of(y, t, t, t, t)


@njit(cache=True, nogil=True)
def _add_coupling(row_start: Array, column: Array, coupling: Array, y: Array) -> None:
    """y[:, :3] += B y[:, 3]"""
    for a in range(row_start.shape[0] - 1):
        diagonal = row_start[a]
        t = _four_times(y, a)
        here = times_plus(row_at(coupling, 2 * diagonal), t, row_at(y, a))
        for k in range(diagonal + 1, row_start[a + 1]):
            b = column[k]
            here = times_plus(row_at(coupling, 2 * k), _four_times(y, b), here)
            put(y, b, times_plus(row_at(coupling, 2 * k + 1), t, row_at(y, b)))
        put(y, a, here)


@njit(cache=True, nogil=True)
def _project(v: Array, nodes: Array, vectors: Array) -> None:
    for k in range(vectors.shape[1]):
        s = 0.0
        for w in range(nodes.shape[0]):
            s += vectors[w, k] * v[nodes[w], 1]
        for w in range(nodes.shape[0]):
            v[nodes[w], 1] -= vectors[w, k] * s


@njit(cache=True, nogil=True)
def _precondition(M: Array, r: Array, z: Array) -> None:
    """z = M r, whose last component is 0 whatever stands there in r."""
    for a in range(r.shape[0]):
        put(z, a, sum_of_columns(times(block_at(M, a), in_rows(row_at(r, a)))))


@njit(cache=True, nogil=True, fastmath=True)
def _dot(a: Array, b: Array) -> float:
    s = 0.0
    for k in range(a.size):
        s += np.float64(a[k]) * np.float64(b[k])
    return s


@njit(cache=True, nogil=True, fastmath=True)
def _add_multiple(y: Array, factor: float, x: Array) -> None:
    """y += factor x"""
    f = np.float32(factor)
    for k in range(y.size):
        y[k] += f * x[k]


@njit(cache=True, nogil=True, fastmath=True)
def _turn(direction: Array, beta: float, z: Array) -> None:
    """direction = z + beta direction"""
    f = np.float32(beta)
    for k in range(z.size):
        direction[k] = z[k] + f * direction[k]


@njit(cache=True, nogil=True)
def _conjugate_gradients(
    row_start: Array, column: Array, blocks: Array, coupling: Array, compliance: Array,
    M: Array, rhs: Array, guard_nodes: Array, guard_vectors: Array,
    tolerance: float, max_iterations: int,
) -> tuple[Array, int, bool]:  # fmt: skip
    # The last component of r gathers what products hold there; M leaves it out.
    r, z, product, x = rhs.copy(), np.empty_like(rhs), np.empty_like(rhs), np.zeros_like(rhs)
    _project(r, guard_nodes, guard_vectors)
    _precondition(M, r, z)
    _project(z, guard_nodes, guard_vectors)
    direction = z.copy()
    rz = _dot(r.ravel(), z.ravel())
    limit = tolerance * tolerance * rz
    iteration, definite = 0, True
    while iteration < max_iterations and rz > limit:
        _multiply(row_start, column, blocks, coupling, compliance, direction, product)
        curvature = _dot(direction.ravel(), product.ravel())
        iteration += 1
        if not curvature > 0.0:
            definite = False
            if iteration == 1:
                x[:] = z
            break
        _project(product, guard_nodes, guard_vectors)
        _add_multiple(x.ravel(), rz / curvature, direction.ravel())
        _add_multiple(r.ravel(), -rz / curvature, product.ravel())
        _precondition(M, r, z)
        _project(z, guard_nodes, guard_vectors)
        rz_next = _dot(r.ravel(), z.ravel())
        _turn(direction.ravel(), rz_next / rz, z.ravel())
        rz = rz_next
    return x, iteration, definite
