"""The inverse map of every deformed tetrahedron, from voxels of the output to voxels of the phantom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh
from simcore.core.errors import SolverError
from simcore.core.grid import Grid


@dataclass(frozen=True, eq=False)
class TetMaps:
    """Affine functions of the output voxel index q = (i, j, k), whose centre lies at the integer q.

    barycentric: float64 (m, 4, 4): weight of node n = b[n, 0] + b[n, 1:] . q
    origin:      float64 (m, 3, 4): position in the phantom, in voxels from its corner: o[axis, 0] + o[axis, 1:] . q
    corners:     float64 (m, 4, 3): the deformed nodes, in output voxels.
    """

    barycentric: NDArray[np.float64]
    origin: NDArray[np.float64]
    corners: NDArray[np.float64]


def tet_maps(mesh: TetMesh, deformed: NDArray[np.float64], output: Grid, source: Grid) -> TetMaps:
    """Maps of all tetrahedra.

    deformed: (n, 3) node positions, mm, in the frame of ``output``; mesh.nodes are in the frame of ``source``.
    raises: SolverError where a tetrahedron has no positive volume.
    """
    cells = (deformed - np.array(output.corner)) / np.array(output.spacing) - 0.5
    corners = cells[mesh.tets]
    edges = corners[:, 1:] - corners[:, :1]
    determinant = np.linalg.det(edges)
    inverted = np.flatnonzero(determinant <= 0)
    if len(inverted):
        raise SolverError(
            f"{len(inverted)} of {len(determinant)} tetrahedra are inverted by the displacement, the first is number "
            f"{inverted[0]}; take less compression or a finer mesh",
            code="inverted-element",
        )
    barycentric = barycentric_weights(corners)
    undeformed = (mesh.nodes - np.array(source.corner)) / np.array(source.spacing)
    origin = np.einsum("mna,mnb->mab", undeformed[mesh.tets], barycentric)
    return TetMaps(barycentric, np.ascontiguousarray(origin), corners)


def barycentric_weights(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 (m, 4, 4): weight of node n of each tetrahedron at the point p = b[n, 0] + b[n, 1:] . p

    corners: float64 (m, 4, 3), none of them flat, in the unit of p.
    """
    # Rows of edges are corners n - corner 0; the columns of its inverse are the gradients of weights 1..3.
    edges = corners[:, 1:] - corners[:, :1]
    barycentric = np.empty((len(corners), 4, 4))
    barycentric[:, 1:, 1:] = np.linalg.inv(edges).transpose(0, 2, 1)
    barycentric[:, 0, 1:] = -barycentric[:, 1:, 1:].sum(axis=1)
    barycentric[:, 1:, 0] = -np.einsum("mna,ma->mn", barycentric[:, 1:, 1:], corners[:, 0])
    barycentric[:, 0, 0] = 1.0 - barycentric[:, 1:, 0].sum(axis=1)
    return barycentric
