"""Products with the condensed tangent and conjugate gradients on it, by several threads. Numba kernels.

The rows are cut into ``PARTS`` whose sums are added in their order, so that the result does not depend on the number of
threads. A row of the upper half also adds to the rows of its columns: every part has a product of its own for that.

The limit is memory: a product reads 96 bytes a block (the block, and its part of B a second time), 4.5 ns at the
20 GB/s of one core, and less where the parts fit into the caches of several.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.fem.blocks import add, block_at, in_columns, in_rows, put, row_at, row_of, sum_of_columns, sum_of_rows
from simcore.fem.team import LEAVE, begin, finish, tickets, together
from simcore.kernels import njit
from simcore.simd.aligned import Singles, empty
from simcore.simd.vector import fma, times

Array = NDArray[Any]

PARTS = 4
_PHASES = 6
_PATIENCE = 40
"""Looks per block of a part: some eight times what the longest phase takes."""
_RZ, _CURVATURE, _GUARDED = 0, 2, 3
"""Rows of the sums: two of rz (of this iteration and the one before), one of the curvature, then those of the guard."""


class Operator(NamedTuple):
    """Upper half storage. row_start: int32 (n + 1,). column: int32 (m,). blocks: float32 (m, 4, 4), of
    simcore.fem.linear.tangent.Tangent, N/mm (the last row and column mm^2). coupling: float32 (m, 2, 4), dR_a/dp_b and
    dR_b/dp_a, mm^2, the last component 0. compliance: float32 (n,), N/mm^5.
    first: int32 (PARTS + 1,), rows of the parts. reach: int32 (PARTS,), one more than the last row a part adds to."""

    row_start: Array
    column: Array
    blocks: Singles
    coupling: Singles
    compliance: Singles
    first: Array
    reach: Array


class Guarded(NamedTuple):
    """nodes: int64 (w,), ascending. vectors: (w, k), orthonormal. first: int64 (PARTS + 1,), nodes of the parts."""

    nodes: Array
    vectors: Array
    first: Array


def cut(row_start: Array, column: Array) -> tuple[Array, Array]:
    """(first, reach) of ``Operator``, parts of like numbers of blocks."""
    first = np.searchsorted(row_start, np.linspace(0, row_start[-1], PARTS + 1)).astype(np.int32)
    first[-1] = len(row_start) - 1
    ends = row_start[first]
    reach = [1 + column[a:b].max(initial=row - 1) for a, b, row in zip(ends[:-1], ends[1:], first[1:], strict=True)]
    return first, np.array(reach, np.int32)


def multiply(operator: Operator, x: Singles) -> tuple[Singles, Singles]:
    """(A x, float32 (n, 4), N; C^-1 B^T x, float32 (n,), N/mm^2). x: (n, 4), mm, the last component 0; nothing is of
    use in the last component of the product."""
    work = _Work.of(len(x), guards=0)
    for part in range(PARTS):
        _upper_half(operator, part, x, work.products[part])
    for part in range(PARTS):
        _pressure(operator, part, work.products, work.pressure)
    _couple(operator, work)
    return work.product, work.pressure


def multiply_coupling(operator: Operator, t: Singles) -> Singles:
    """B t, float32 (n, 4), N. t: float32 (n,), N/mm^2."""
    work = _Work.of(len(t), guards=0)
    work.products[:], work.pressure[:] = 0.0, t
    _couple(operator, work)
    return work.product


def _couple(operator: Operator, work: _Work) -> None:
    for part in range(PARTS):
        _coupled(operator, part, work.pressure, work.products[part])
    for part in range(PARTS):
        _gathered(operator, part, work.products, work.product)


class Ended(NamedTuple):
    """x: float32 (n, 4), mm. definite: whether A was positive along every direction; it ends where A is not.
    converged: whether the tolerance was met, and not the limit of iterations."""

    x: Singles
    iterations: int
    definite: bool
    converged: bool


def solve(
    operator: Operator, preconditioner: Singles, rhs: Singles, guarded: Guarded, tolerance: float, max_iterations: int
) -> Ended:
    """A x = rhs in the space that the guard leaves.

    preconditioner: float32 (n, 4, 4), mm/N, the last row and column 0. rhs: float32 (n, 4), N, or any multiple of it,
    without a part along the guard: one that is much larger than the rest cannot be taken out in single precision, and
    what is left of it stays in r . M r for ever. tolerance: on the root of r . M r, relative to its first value.
    """
    work = _Work.of(len(rhs), guards=guarded.vectors.shape[1])
    x, r, direction = empty(*rhs.shape), empty(*rhs.shape), empty(*rhs.shape)
    x[:], r[:] = 0.0, rhs
    rz = _start(preconditioner, r, direction, guarded.nodes, guarded.vectors)
    work.sums[_RZ, 0] = rz
    numbers = tickets()
    limit = tolerance * tolerance * rz
    patience = _PATIENCE * (1 + len(operator.column) // PARTS)

    def work_of(callers: bool) -> tuple[int, bool]:
        iterations, definite = _iterate(
            numbers, patience, callers, operator, preconditioner, guarded, work, x, r, direction, limit, max_iterations
        )
        return int(iterations), bool(definite)

    iterations, definite = together(work_of, PARTS)
    converged = definite and bool(work.sums[_RZ + iterations % 2].sum() <= limit)
    return Ended(direction if iterations == 1 and not definite else x, iterations, definite, converged)


class _Work(NamedTuple):
    """product, z: (n, 4). products: (PARTS, n, 4), of the parts. pressure: (n,). sums: float64 (rows, PARTS)."""

    product: Singles
    z: Singles
    products: Singles
    pressure: Singles
    sums: Array

    @classmethod
    def of(cls, n: int, guards: int) -> _Work:
        sums = np.zeros((_GUARDED + 2 * guards, PARTS))
        return cls(empty(n, 4), empty(n, 4), empty(PARTS, n, 4), empty(n), sums)


@njit(cache=True, nogil=True)
def _upper_half(operator: Any, part: int, x: Array, y: Array) -> None:
    """What the part's rows and their transposes add to y: K x, and B^T x in the last component."""
    blocks, column = operator.blocks, operator.column
    y[operator.first[part] : operator.reach[part]] = 0.0
    for a in range(operator.first[part], operator.first[part + 1]):
        diagonal = operator.row_start[a]
        from_here = in_columns(row_at(x, a))
        here = times(block_at(blocks, diagonal), in_rows(row_at(x, a)))
        for k in range(diagonal + 1, operator.row_start[a + 1]):
            b = column[k]
            block = block_at(blocks, k)
            here = fma(block, in_rows(row_at(x, b)), here)
            add(y, b, sum_of_rows(times(block, from_here)))
        add(y, a, sum_of_columns(here))


@njit(cache=True, nogil=True)
def _pressure(operator: Any, part: int, products: Array, pressure: Array) -> None:
    """pressure = C^-1 B^T x in the part's rows."""
    start, stop = operator.first[part], operator.first[part + 1]
    for a in range(start, stop):
        pressure[a] = products[part, a, 3]
    for other in range(part):
        for a in range(start, min(stop, operator.reach[other])):
            pressure[a] += products[other, a, 3]
    for a in range(start, stop):
        pressure[a] *= operator.compliance[a]


@njit(cache=True, nogil=True)
def _coupled(operator: Any, part: int, pressure: Array, y: Array) -> None:
    """Adds B pressure to y, of the part's rows and their transposes."""
    coupling, column = operator.coupling, operator.column
    for a in range(operator.first[part], operator.first[part + 1]):
        diagonal = operator.row_start[a]
        from_here = _four_times(y, pressure[a])
        here = fma(row_at(coupling, 2 * diagonal), from_here, row_at(y, a))
        for k in range(diagonal + 1, operator.row_start[a + 1]):
            b = column[k]
            here = fma(row_at(coupling, 2 * k), _four_times(y, pressure[b]), here)
            put(y, b, fma(row_at(coupling, 2 * k + 1), from_here, row_at(y, b)))
        put(y, a, here)


@njit(cache=True, nogil=True)
def _four_times(like: Array, t: float) -> Any:
    return row_of(like, t, t, t, t)


@njit(cache=True, nogil=True)
def _gathered(operator: Any, part: int, products: Array, y: Array) -> None:
    """y in the part's rows: what this part and those before it have of it."""
    start, stop, own = operator.first[part], operator.first[part + 1], products[part]
    for a in range(start, stop):
        put(y, a, row_at(own, a))
    for other in range(part):
        for a in range(start, min(stop, operator.reach[other])):
            add(y, a, row_at(products[other], a))


@njit(cache=True, nogil=True)
def _start(M: Array, r: Array, direction: Array, guard_nodes: Array, guard_vectors: Array) -> float:
    """The first direction, and r . M r."""
    project(r, guard_nodes, guard_vectors)
    _precondition(M, r, direction)
    project(direction, guard_nodes, guard_vectors)
    return float(_dot(r.ravel(), direction.ravel()))


@njit(cache=True, nogil=True)
def project(v: Array, nodes: Array, vectors: Array) -> None:
    """Takes vectors (w, k) at the y components of nodes (w,) out of v, in place."""
    for k in range(vectors.shape[1]):
        s = 0.0
        for w in range(nodes.shape[0]):
            s += vectors[w, k] * v[nodes[w], 1]
        for w in range(nodes.shape[0]):
            v[nodes[w], 1] -= vectors[w, k] * s


@njit(cache=True, nogil=True)
def _iterate(
    numbers: Array, patience: int, callers: bool,
    operator: Any, M: Array, guarded: Any, work: Any, x: Array, r: Array, direction: Array,
    limit: float, max_iterations: int,
) -> tuple[int, bool]:  # fmt: skip
    """What every thread does until all are through: (iterations, definite)."""
    sums, product, z = work.sums, work.product, work.z
    of_product, of_z = _GUARDED, _GUARDED + guarded.vectors.shape[1]
    while True:
        turn, part = begin(numbers, PARTS, patience, callers)
        if turn == LEAVE:
            return 0, True
        iteration, phase = turn // _PHASES, turn % _PHASES
        now, then = _RZ + iteration % 2, _RZ + (iteration + 1) % 2
        start, stop = operator.first[part], operator.first[part + 1]
        if phase == 0:
            if iteration >= max_iterations or not sums[now].sum() > limit:
                return iteration, True
            _upper_half(operator, part, direction, work.products[part])
        elif phase == 1:
            _pressure(operator, part, work.products, work.pressure)
        elif phase == 2:
            _coupled(operator, part, work.pressure, work.products[part])
        elif phase == 3:
            _gathered(operator, part, work.products, product)
            sums[_CURVATURE, part] = _dot(direction[start:stop].ravel(), product[start:stop].ravel())
            _guarded_sums(guarded, part, product, sums, of_product)
        elif phase == 4:
            curvature = sums[_CURVATURE].sum()
            if not curvature > 0.0:
                return iteration + 1, False
            alpha = sums[now].sum() / curvature
            _take_guarded(guarded, part, product, sums, of_product)
            _add_multiple(x[start:stop].ravel(), alpha, direction[start:stop].ravel())
            _add_multiple(r[start:stop].ravel(), -alpha, product[start:stop].ravel())
            _precondition(M[start:stop], r[start:stop], z[start:stop])
            # r is guarded already, so that this is r . z with the guarded z as well.
            sums[then, part] = _dot(r[start:stop].ravel(), z[start:stop].ravel())
            _guarded_sums(guarded, part, z, sums, of_z)
        else:
            _take_guarded(guarded, part, z, sums, of_z)
            _turn(direction[start:stop].ravel(), sums[then].sum() / sums[now].sum(), z[start:stop].ravel())
        finish(numbers)


@njit(cache=True, nogil=True)
def _guarded_sums(guarded: Any, part: int, v: Array, sums: Array, row: int) -> None:
    """What the part has of the guarded components of v."""
    for k in range(guarded.vectors.shape[1]):
        s = 0.0
        for w in range(guarded.first[part], guarded.first[part + 1]):
            s += guarded.vectors[w, k] * v[guarded.nodes[w], 1]
        sums[row + k, part] = s


@njit(cache=True, nogil=True)
def _take_guarded(guarded: Any, part: int, v: Array, sums: Array, row: int) -> None:
    """Takes the guarded components out of the part's v."""
    for k in range(guarded.vectors.shape[1]):
        s = sums[row + k].sum()
        for w in range(guarded.first[part], guarded.first[part + 1]):
            v[guarded.nodes[w], 1] -= guarded.vectors[w, k] * s


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
