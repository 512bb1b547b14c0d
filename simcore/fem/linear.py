"""The tangent with the pressure condensed, A = K + B C^-1 B^T with C diagonal, and linear systems with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simcore.fem import conjugate_gradients
from simcore.fem.blocks import Singles, empty
from simcore.fem.conjugate_gradients import Guarded, Operator, project
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

    operator: blocks (m, 4, 4) of [[K, B], [B^T, 0]]: K = dR_a/du_b, the last column dR_a/dp_b, the last row dR_b/dp_a;
    B again, and C^-1.
    """

    operator: Operator

    @classmethod
    def of(cls, pattern: Pattern, system: System, compliance: Floats) -> Tangent:
        """system: in single precision; its blocks are used, not copied. compliance: C^-1, (n,)."""
        coupling = empty(len(pattern.column), 2, 4)
        _copy_coupling(system.blocks, coupling)
        matrix = (pattern.row_start, pattern.column, system.blocks, coupling, compliance.astype(np.float32))
        return cls(Operator(*matrix, *conjugate_gradients.cut(pattern.row_start, pattern.column)))

    @property
    def compliance(self) -> Singles:
        """C^-1, float32 (n,)."""
        return self.operator.compliance

    def apply(self, x: Floats) -> tuple[Floats, Floats]:
        """(A x (n, 3), C^-1 B^T x (n,))."""
        product, pressure = conjugate_gradients.multiply(self.operator, _wide(x))
        return product[:, :3].astype(np.float64), pressure.astype(np.float64)

    def apply_coupling(self, t: Floats) -> Floats:
        """B t, (n, 3)."""
        product = conjugate_gradients.multiply_coupling(self.operator, t.astype(np.float32))
        return product[:, :3].astype(np.float64)

    def solve(
        self, rhs: Floats, constraints: Constraints, guard: Guard, tolerance: float, max_iterations: int = 4000
    ) -> Solved:
        """x with A x = rhs in the space that the constraints and the guard leave, (n, 3).

        tolerance: on the preconditioned residual, relative to its first value.
        Where A is not positive along a direction it ends with what it has by then.
        """
        preconditioner = empty(len(rhs), 4, 4)
        operator = self.operator
        invert_diagonal(
            operator.row_start, operator.column, operator.blocks, operator.compliance,
            constraints.free, constraints.gliding, constraints.normal, preconditioner,
        )  # fmt: skip
        r = rhs.copy()
        constraints.project(r)
        # Products of single precision overflow and vanish for forces far from 1.
        scale = float(np.abs(r).max(initial=0.0)) or 1.0
        x, iterations, definite = conjugate_gradients.solve(
            self.operator,
            preconditioner,
            _wide(r / scale),
            guard.in_parts(self.operator.first),
            tolerance,
            max_iterations,
        )
        return Solved(x[:, :3].astype(np.float64) * scale, iterations, definite)


def _wide(x: Floats) -> Singles:
    """(n, 4) float32, the last component 0, of x (n, 3)."""
    wide = empty(len(x), 4)
    wide[:, :3] = x
    wide[:, 3] = 0.0
    return wide


@dataclass(frozen=True, eq=False)
class Guard:
    """Constraints vectors^T v_y[nodes] = 0: no drift along y and no roll about x of the chest wall.

    nodes: int64 (w,), ascending. vectors: (w, k), orthonormal.
    """

    nodes: NDArray[np.int64]
    vectors: Floats

    @classmethod
    def against_roll(cls, nodes: Floats, wall: NDArray[np.int64]) -> Guard:
        """A wall that is free in its plane lets a tall breast drift and tip over between frictionless plates."""
        wall = np.sort(wall)
        z = nodes[wall, 2]
        basis = np.linalg.qr(np.stack([np.ones(len(z)), z - z.mean()], axis=1))[0]
        return cls(np.ascontiguousarray(wall, dtype=np.int64), np.ascontiguousarray(basis))

    @classmethod
    def none(cls) -> Guard:
        """No constraint: for a wall that is held by its nodes."""
        return cls(np.empty(0, np.int64), np.empty((0, 0)))

    def project(self, v: Floats) -> None:
        """Takes the guarded components out of v (n, 3), in place."""
        project(v, self.nodes, self.vectors)

    def in_parts(self, first: NDArray[np.int32]) -> Guarded:
        """first: rows of the parts."""
        return Guarded(self.nodes, self.vectors, np.searchsorted(self.nodes, first))


@njit(cache=True, nogil=True)
def _copy_coupling(blocks: Array, coupling: Array) -> None:
    for k in range(blocks.shape[0]):
        for i in range(3):
            coupling[k, 0, i] = blocks[k, i, 3]
            coupling[k, 1, i] = blocks[k, 3, i]
        coupling[k, 0, 3] = coupling[k, 1, 3] = 0.0
