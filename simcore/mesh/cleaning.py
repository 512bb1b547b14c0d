"""Repairs after the mesher: orientation, one connected body, the chest wall exactly at x = 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from simcore.core.errors import MeshError
from simcore.mesh.quality import boundary_faces, volumes

_KEPT_VOLUME = 0.2
"""A tetrahedron may lose this much less than all of its volume to the move of its nodes onto the wall."""


def oriented(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.int64]:
    """All tetrahedra with positive volume."""
    tets = tets.copy()
    negative = volumes(nodes, tets) < 0
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return tets


def compacted(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Without the nodes that no tetrahedron uses."""
    used, inverse = np.unique(tets, return_inverse=True)
    return np.ascontiguousarray(nodes[used]), np.ascontiguousarray(inverse.reshape(tets.shape).astype(np.int64))


def largest_body(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.int64]:
    """The tetrahedra of the largest connected piece.

    raises: MeshError where it holds less than 99 % of the volume.
    """
    rows, columns = np.repeat(tets[:, 0], 3), tets[:, 1:].ravel()
    graph = csr_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(nodes), len(nodes)))
    count, piece = connected_components(graph, directed=False)
    if count == 1:
        return tets
    volume = np.bincount(piece[tets[:, 0]], weights=volumes(nodes, tets))
    if volume.max() < 0.99 * volume.sum():
        raise MeshError(
            f"the mesh falls into {np.count_nonzero(volume)} pieces, the largest with "
            f"{volume.max() / volume.sum():.1%} of the volume",
            code="mesh-pieces",
        )
    return np.ascontiguousarray(tets[piece[tets[:, 0]] == volume.argmax()])


def snapped_to_wall(
    nodes: NDArray[np.float64], tets: NDArray[np.int64], tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Boundary nodes near the chest wall moved to x = 0 exactly.

    tolerance: mm; faces within it that look towards the wall belong to the wall. A move that would leave a
    tetrahedron with less than _KEPT_VOLUME of its volume is left out; what gets flat on the wall is dropped.
    """
    faces = boundary_faces(tets)
    wall = np.zeros(len(nodes), dtype=bool)
    wall[faces[_faces_wall(nodes, faces, tolerance)]] = True
    wall[np.unique(faces)] |= nodes[np.unique(faces), 0] <= 0
    before = volumes(nodes, tets)
    for _ in range(20):
        moved = nodes.copy()
        moved[wall, 0] = 0.0
        flat = wall[tets].all(axis=1)
        spoilt = np.unique(tets[(volumes(moved, tets) < _KEPT_VOLUME * before) & ~flat])
        spoilt = spoilt[wall[spoilt] & (np.abs(nodes[spoilt, 0]) > 1e-3 * tolerance)]
        if not len(spoilt):
            return compacted(moved, tets[~flat])
        wall[spoilt] = False
    raise MeshError(
        "the mesh cannot be made flat at the chest wall; take a smaller mesh.edge_length_mm or mesh.kind = 'lattice'",
        code="mesh-no-wall",
    )


def _faces_wall(nodes: NDArray[np.float64], faces: NDArray[np.int64], tolerance: float) -> NDArray[np.bool_]:
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-300
    return np.asarray((nodes[faces][:, :, 0].max(axis=1) < tolerance) & (normal[:, 0] < -0.7))


def wall_and_skin(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(nodes of the boundary faces with x == 0, ascending; the other boundary faces)."""
    faces = boundary_faces(tets)
    on_wall = (nodes[faces][:, :, 0] == 0.0).all(axis=1)
    return np.unique(faces[on_wall]), np.ascontiguousarray(faces[~on_wall])
