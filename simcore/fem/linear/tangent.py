"""The tangent with the pressure condensed, A = K + B C^-1 B^T with C diagonal, and linear systems with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.fem.elements.model import Floats, Pattern, System
from simcore.fem.linear import conjugate_gradients
from simcore.fem.linear.conjugate_gradients import Guarded, Operator, project
from simcore.fem.linear.preconditioner import invert_diagonal
from simcore.fem.plates.constraints import Constraints
from simcore.kernels import njit
from simcore.simd.aligned import Singles, empty

Array = NDArray[Any]


MAX_ITERATIONS = 4000
"""Of conjugate gradients. Well-shaped meshes of 10k to 300k tetrahedra take 50 to 400."""
_RESTARTS = 2


class Solved(NamedTuple):
    """x: (n, 3). definite: whether A was positive along every direction that was tried. converged: whether the
    tolerance was met; False where A is not definite or the limit of iterations was reached."""

    x: Floats
    iterations: int
    definite: bool
    converged: bool


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
        self,
        rhs: Floats,
        constraints: Constraints,
        guard: Guard,
        tolerance: float,
        max_iterations: int = MAX_ITERATIONS,
    ) -> Solved:
        """x with A x = rhs in the space that the constraints and the guard leave, (n, 3).

        tolerance: on the preconditioned residual, relative to its first value.
        Where A is not positive along a direction it ends with what it has by then. Where the limit of iterations is
        reached it starts again from there with the true residual, twice at most and as long as that halves.
        """
        preconditioner = empty(len(rhs), 4, 4)
        operator = self.operator
        invert_diagonal(
            operator.row_start, operator.column, operator.blocks, operator.compliance,
            constraints.free, constraints.gliding, constraints.normal, preconditioner,
        )  # fmt: skip

        def in_space(v: Floats) -> Floats:
            constraints.project(v)
            guard.project(v)
            return v

        x, r = np.zeros_like(rhs), in_space(rhs.copy())
        first = size = norm(r)
        iterations = 0
        guarded = guard.in_parts(operator.first)
        for _ in range(1 + _RESTARTS):
            # Products of single precision overflow and vanish for forces far from 1.
            scale = float(np.abs(r).max(initial=0.0)) or 1.0
            relative = min(tolerance * first / max(size, 1e-300), 1.0)
            ended = conjugate_gradients.solve(
                operator, preconditioner, _wide(r / scale), guarded, relative, max_iterations
            )
            iterations += ended.iterations
            x += in_space(ended.x[:, :3].astype(np.float64) * scale)
            if ended.converged or not ended.definite:
                return Solved(x, iterations, ended.definite, ended.converged)
            r = in_space(rhs - self.apply(x)[0])
            before, size = size, norm(r)
            if not size < 0.5 * before:
                break
        return Solved(x, iterations, True, False)


def _wide(x: Floats) -> Singles:
    """(n, 4) float32, the last component 0, of x (n, 3)."""
    wide = empty(len(x), 4)
    wide[:, :3] = x
    wide[:, 3] = 0.0
    return wide


def norm(values: Floats) -> float:
    """Root of the sum of squares. Not numpy.linalg.norm: its sum depends on the number of threads."""
    return float(np.sqrt((values * values).sum()))


@dataclass(frozen=True, eq=False)
class Guard:
    """Constraints vectors^T v_y[nodes] = 0: no drift along y and no roll about x of the chest wall.

    nodes: int64 (w,), ascending, none held along y. vectors: (w, k), orthonormal.
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

    def among(self, free: NDArray[np.bool_]) -> Guard:
        """The same constraints where only the nodes ``free`` (n,) can move along y: vectors at supports would mix what
        the supports forbid with what the guard does."""
        moves = free[self.nodes]
        if moves.all():
            return self
        left, sizes, _ = np.linalg.svd(self.vectors[moves], full_matrices=False)
        return Guard(self.nodes[moves], np.ascontiguousarray(left[:, sizes > 1e-9 * sizes.max(initial=0.0)]))

    def project(self, v: Floats) -> None:
        """Takes the guarded components out of v (n, 3), in place."""
        project(v, self.nodes, self.vectors)

    def drift(self, v: Floats) -> float:
        """Largest movement of the wall's nodes along y that the guard forbids, in the units of v (n, 3)."""
        along = self.vectors @ (self.vectors.T @ v[self.nodes, 1])
        return float(np.abs(along).max(initial=0.0))

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
