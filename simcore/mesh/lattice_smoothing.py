"""The few flat or sharp tetrahedra that stuffing leaves where the outline is rough, made better by moving their nodes.

The bound of the stencils alone is 9.2 degrees (any outline); smooth outlines stay above 17. Nodes of the tetrahedra
below the goal are moved one after the other to the best of a few places near by, those of the surface on the surface,
those of the wall in the wall. Serial, so the result does not depend on threads.

Source: the idea of Freitag, Ollivier-Gooch, Tetrahedral mesh improvement using swapping and smoothing, Int. J. Numer.
Meth. Engng 40 (1997) 3979; a pattern search in place of their linear programs.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit
from simcore.mesh.lattice_field import value_at
from simcore.mesh.surface import OccupancyField

GOAL_DEG = 16.0
"""Tetrahedra with an angle below this, or above 180 less this, are improved."""
ROUNDS = 6
_STEPS = np.array([0.16, 0.08, 0.04, 0.02, 0.01])
"""Lengths of the moves over the lattice constant."""
_DIRECTIONS = np.array(
    [np.array(d) / np.linalg.norm(d) for d in itertools.product((-1, 0, 1), repeat=3) if d != (0, 0, 0)]
)


@njit(cache=True, nogil=True)
def _normal(nodes: Any, a: int, b: int, c: int, n: Any) -> None:
    """Unit normal of a triangle."""
    ux, uy, uz = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
    vx, vy, vz = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1], nodes[c, 2] - nodes[a, 2]
    n[0], n[1], n[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) + 1e-300
    n[0] /= length
    n[1] /= length
    n[2] /= length


@njit(cache=True, nogil=True)
def _worst_cosine(nodes: Any, tet: Any, normals: Any) -> float:
    """Largest |cosine| of the dihedral angles; 2 where the volume is not positive."""
    a, b, c, d = tet[0], tet[1], tet[2], tet[3]
    _normal(nodes, b, c, d, normals[0])
    _normal(nodes, a, d, c, normals[1])
    _normal(nodes, a, b, d, normals[2])
    _normal(nodes, a, c, b, normals[3])
    height = 0.0
    for k in range(3):
        height += normals[3, k] * (nodes[a, k] - nodes[d, k])
    if height <= 0.0:
        return 2.0
    worst = 0.0
    for i in range(4):
        for j in range(i + 1, 4):
            cosine = 0.0
            for k in range(3):
                cosine += normals[i, k] * normals[j, k]
            worst = max(worst, abs(cosine))
    return worst


@njit(cache=True, nogil=True)
def _star_worst(nodes: Any, tets: Any, first: Any, around: Any, node: int, normals: Any) -> float:
    worst = 0.0
    for m in range(first[node], first[node + 1]):
        worst = max(worst, _worst_cosine(nodes, tets[around[m]], normals))
    return worst


@njit(cache=True, nogil=True)
def _onto_surface(values: Any, origin: Any, spacing: Any, level: float, point: Any, in_wall: bool) -> bool:
    """Newton's steps along the gradient; False where they do not arrive."""
    for _ in range(6):
        x, y, z = point[0], point[1], point[2]
        off = value_at(values, origin, spacing, x, y, z) - level
        if abs(off) < 1e-5:
            return True
        h = 0.25 * spacing[0]
        gx = (value_at(values, origin, spacing, x + h, y, z) - value_at(values, origin, spacing, x - h, y, z)) / (2 * h)
        h = 0.25 * spacing[1]
        gy = (value_at(values, origin, spacing, x, y + h, z) - value_at(values, origin, spacing, x, y - h, z)) / (2 * h)
        h = 0.25 * spacing[2]
        gz = (value_at(values, origin, spacing, x, y, z + h) - value_at(values, origin, spacing, x, y, z - h)) / (2 * h)
        if in_wall:
            gx = 0.0
        square = gx * gx + gy * gy + gz * gz
        if square * spacing[0] * spacing[0] < 1e-6:
            return False
        point[0] -= off * gx / square
        point[1] -= off * gy / square
        point[2] -= off * gz / square
    return False


@njit(cache=True, nogil=True)
def _improve(
    nodes: Any, tets: Any, first: Any, around: Any, on_surface: Any, goal: float, constant: float,
    values: Any, origin: Any, spacing: Any, level: float, steps: Any, directions: Any, rounds: int,
) -> None:  # fmt: skip
    normals = np.empty((4, 3))
    place, best = np.empty(3), np.empty(3)
    for _ in range(rounds):
        is_bad = np.zeros(len(nodes), dtype=np.bool_)
        for t in range(len(tets)):
            if _worst_cosine(nodes, tets[t], normals) > goal:
                for k in range(4):
                    is_bad[tets[t, k]] = True
        if not is_bad.any():
            return
        for node in np.flatnonzero(is_bad):
            in_wall = nodes[node, 0] == 0.0
            for step in steps:
                start = nodes[node].copy()
                best[:] = start
                worst = _star_worst(nodes, tets, first, around, node, normals)
                for direction in directions:
                    place[:] = start + step * constant * direction
                    if in_wall:
                        place[0] = 0.0
                    elif place[0] <= 0.0:
                        continue
                    if on_surface[node] and not _onto_surface(values, origin, spacing, level, place, in_wall):
                        continue
                    if not in_wall and place[0] <= 0.0:
                        continue
                    nodes[node] = place
                    now = _star_worst(nodes, tets, first, around, node, normals)
                    if now < worst - 1e-6:
                        worst = now
                        best[:] = place
                nodes[node] = best


def smoothed(
    field: OccupancyField,
    nodes: NDArray[np.float64],
    tets: NDArray[np.int64],
    on_surface: NDArray[np.bool_],
    constant: float,
) -> NDArray[np.float64]:
    """Nodes with those of bad tetrahedra moved.

    nodes: (n, 3), mm; tets: (m, 4), positive; on_surface: (n,) nodes that stay on the outline; nodes with x == 0 stay
    in the wall. constant: edge of the cubic cell, mm.
    """
    counts = np.bincount(tets.ravel(), minlength=len(nodes))
    first = np.concatenate([[0], np.cumsum(counts)])
    around = np.argsort(tets.ravel(), kind="stable") // 4
    nodes = nodes.copy()
    _improve(
        nodes, tets, first, around, on_surface, float(np.cos(np.radians(GOAL_DEG))), constant,
        field.values, field.origin, field.spacing, field.level, _STEPS, _DIRECTIONS, ROUNDS,
    )  # fmt: skip
    return nodes
