"""How a lattice tetrahedron is cut by the surface: a table from the signs of its corners to tetrahedra.

Lengths count in units of half the lattice constant, in lattice coordinates (p, q, k) with p + q + k even: p along the
normal of the chest wall, a {110} direction of the cubic lattice, k along one of its cubic axes. All tetrahedra of the
lattice are congruent, and its {110} planes, the wall among them, are mirrors made of whole faces.

Source: Labelle, Shewchuk, Isosurface stuffing: fast tetrahedral meshes with good dihedral angles, ACM Trans. Graph. 26
(2007) 57.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

SHAPE = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.5])
"""Lengths of a step along p, q and k over the lattice constant."""

LONG_STEPS = ((1, 1, 0), (1, -1, 0), (0, 0, 2))
SHORT_STEPS = ((1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1))
STEPS = np.array(LONG_STEPS + SHORT_STEPS)
"""Edges of the lattice, one of each pair of opposite ones."""

CORNERS = np.array(
    [
        [(0, 0, 0), (1, 1, 0), (0, 1, 1), (1, 0, 1)],
        [(0, 0, 0), (1, 1, 0), (0, 1, -1), (1, 0, -1)],
        [(0, 0, 0), (1, -1, 0), (1, 0, -1), (1, 0, 1)],
        [(0, 0, 0), (1, -1, 0), (0, -1, -1), (0, -1, 1)],
        [(0, 0, 0), (0, 0, 2), (0, -1, 1), (1, 0, 1)],
        [(0, 0, 0), (0, 0, 2), (-1, 0, 1), (0, 1, 1)],
    ]
)
"""The six tetrahedra that belong to a lattice point; the edges 0-1 and 2-3 of each are long."""

EDGES = ((0, 1), (2, 3), (0, 2), (0, 3), (1, 2), (1, 3))
"""Corner 4 + e of a stencil is the cut of edge e; the first two edges are long."""
_LONG = frozenset(EDGES[:2])

Tets = list[tuple[int, int, int, int]]
Diagonal = Callable[[int, int, int], bool]
"""(inside corner a, inside corner b, outside corner n) -> the quadrilateral that the cut leaves of triangle a b n is
divided from a (else from b)."""


def _cut(a: int, b: int) -> int:
    return 4 + EDGES.index((min(a, b), max(a, b)))


def _prism(top: tuple[int, int, int], bottom: tuple[int, int, int], starts: list[int]) -> Tets:
    """``starts``: the corner (0, 1, 2) of the top where the diagonal of each side starts; one of each twice is two."""
    u, v, w = sorted(range(3), key=lambda i: -starts.count(i))
    return [
        (top[u], bottom[u], bottom[v], bottom[w]),
        (top[u], top[v], bottom[v], bottom[w]),
        (top[u], top[v], top[w], bottom[w]),
    ]


def stencil(signs: tuple[int, int, int, int], from_first: Diagonal) -> Tets:
    """What is left of a tetrahedron whose corners lie inside (1), on (0) or outside (-1) the surface."""
    inside = [i for i in range(4) if signs[i] > 0]
    on = [i for i in range(4) if signs[i] == 0]
    outside = [i for i in range(4) if signs[i] < 0]
    if not inside:
        return []
    if len(inside) == 1 or not outside:
        kept = [i if signs[i] >= 0 else _cut(inside[0], i) for i in range(4)]
        return [(kept[0], kept[1], kept[2], kept[3])]
    if len(inside) == 3:
        n = outside[0]
        sides = list(itertools.combinations(range(3), 2))
        starts = [i if from_first(inside[i], inside[j], n) else j for i, j in sides]
        cuts = [_cut(i, n) for i in inside]
        return _prism((inside[0], inside[1], inside[2]), (cuts[0], cuts[1], cuts[2]), starts)
    a, b = inside
    if on:
        n, z = outside[0], on[0]
        cut_a, cut_b = _cut(a, n), _cut(b, n)
        if from_first(a, b, n):
            return [(z, a, b, cut_b), (z, a, cut_b, cut_a)]
        return [(z, a, b, cut_a), (z, b, cut_b, cut_a)]
    # A prism between the triangles at a and b. The diagonal of the surface is free: it must not close a cycle.
    m, n = outside
    first_m, first_n = from_first(a, b, m), from_first(a, b, n)
    top, bottom = (a, _cut(a, m), _cut(a, n)), (b, _cut(b, m), _cut(b, n))
    return _prism(top, bottom, [0 if first_m else 1, 0 if first_n else 2, 2 if first_m and not first_n else 1])


def _diagonals(corners: NDArray[np.int64]) -> Diagonal:
    """The same choice from both tetrahedra of a face: from the corner whose edge to the outside is short (the other
    choice allows 6 degrees); between two short edges by parity, which differs between the ends of a long edge."""
    crystal = np.stack([corners[:, 0] + corners[:, 1], corners[:, 0] - corners[:, 1], corners[:, 2]], axis=1)

    def from_first(a: int, b: int, n: int) -> bool:
        for corner, first in ((a, True), (b, False)):
            if (min(corner, n), max(corner, n)) in _LONG:
                return not first
        return bool(np.count_nonzero(crystal[n] > crystal[a]) % 2)

    return from_first


def all_signs() -> Iterator[tuple[int, int, int, int]]:
    """The 81 sign patterns in the order of the table."""
    for signs in itertools.product((-1, 0, 1), repeat=4):
        yield signs[0], signs[1], signs[2], signs[3]


@cache
def table() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(number of tetrahedra, (6, 81); their corners, (6, 81, 3, 4), positive), by tetrahedron of CORNERS and pattern
    27 s0 + 9 s1 + 3 s2 + s3 + 40."""
    count = np.zeros((6, 81), dtype=np.int64)
    corners = np.zeros((6, 81, 3, 4), dtype=np.int64)
    for t, lattice in enumerate(CORNERS):
        points = np.concatenate([lattice, [(lattice[a] + lattice[b]) / 2 for a, b in EDGES]]) * SHAPE
        for pattern, signs in enumerate(all_signs()):
            for m, tet in enumerate(stencil(signs, _diagonals(lattice))):
                a, b, c, d = points[list(tet)]
                positive = np.dot(b - a, np.cross(c - a, d - a)) > 0
                corners[t, pattern, m] = tet if positive else (tet[0], tet[2], tet[1], tet[3])
                count[t, pattern] = m + 1
    return count, corners
