"""Meshes of simple bodies without a mesher: for checks against closed forms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh
from simcore.mesh.cleaning import oriented, wall_and_skin
from simcore.mesh.quality import quality_report

_SIX_TETS = np.array([[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]])
"""Kuhn's division of a cube with corners 4 i + 2 j + k."""


def box(
    size: tuple[float, float, float],
    cells: tuple[int, int, int],
    *,
    jitter: float = 0.0,
    generator: np.random.Generator | None = None,
) -> TetMesh:
    """A box 0 <= x <= size[0], centred in y and z, each cell cut into six tetrahedra.

    size: edges (x, y, z), mm; cells: number along (x, y, z).
    jitter: inner nodes are moved by up to this fraction of a cell, with ``generator``.
    """
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, cells, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((nodes > 0) & (nodes < np.array(size))).all(axis=1)
    if jitter > 0 and generator is not None:
        cell = np.array(size) / np.array(cells)
        nodes[inner] += jitter * cell * generator.uniform(-1, 1, (int(inner.sum()), 3))
    nodes -= np.array([0.0, size[1] / 2, size[2] / 2])
    return _finished(nodes, cube_tets(cells))


def half_ellipsoid(semi_axes: tuple[float, float, float, float], cells: int) -> TetMesh:
    """A half ellipsoid x >= 0: (x/a)^2 + (y/b)^2 + (z/c)^2 <= 1, c differing above and below z = 0.

    semi_axes: (a, b, c upper, c lower), mm; cells: number of cells from the centre to the surface; 4 cells^3 tets.
    """
    depth, half_width, upper, lower = semi_axes
    octant = _octant_tets(cells)
    corners = np.concatenate([octant * np.array([1, y, z]) for y in (1, -1) for z in (1, -1)])
    lattice, inverse = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    # Shells of the octahedron become shells of the sphere.
    length = np.linalg.norm(lattice, axis=1, keepdims=True)
    sphere = lattice * np.abs(lattice).sum(axis=1, keepdims=True) / np.maximum(length, 1) / cells
    nodes = sphere * np.array([depth, half_width, 1.0])
    nodes[:, 2] *= np.where(nodes[:, 2] > 0, upper, lower)
    return _finished(nodes, inverse.reshape(-1, 4).astype(np.int64))


def _octant_tets(cells: int) -> NDArray[np.int64]:
    """Lattice points (cells^3, 4, 3) of the tetrahedra that fill x, y, z >= 0, x + y + z <= cells. Each unit cube is
    cut by x + y + z = 1 and 2 (plus its corner) into a tetrahedron, an octahedron and a tetrahedron."""
    x, y, z = np.eye(3, dtype=np.int64)
    ring = [x, x + z, y + z, y]  # around the octahedron's axis from x + y to z
    pieces = [
        (1, [[0 * x, x, y, z]]),
        (2, [[x + y, z, ring[k], ring[(k + 1) % 4]] for k in range(4)]),
        (3, [[x + y, x + z, y + z, x + y + z]]),
    ]
    corner = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.concatenate(
        [
            corner[corner.sum(axis=1) <= cells - least][:, None, :] + np.array(tet)
            for least, tets in pieces
            for tet in tets
        ]
    )


def cube_tets(cells: tuple[int, int, int]) -> NDArray[np.int64]:
    """Six tetrahedra in every cell of a grid of nodes (nx + 1, ny + 1, nz + 1), the last index running fastest."""
    nx, ny, nz = cells
    i, j, k = np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij")
    corners = [
        (((i + a) * (ny + 1) + (j + b)) * (nz + 1) + (k + c)).ravel() for a in (0, 1) for b in (0, 1) for c in (0, 1)
    ]
    return np.stack(corners, axis=1)[:, _SIX_TETS].reshape(-1, 4).astype(np.int64)


def _finished(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> TetMesh:
    tets = oriented(nodes, tets)
    wall, skin = wall_and_skin(nodes, tets)
    return TetMesh(nodes, tets, wall, skin, quality_report(nodes, tets))
