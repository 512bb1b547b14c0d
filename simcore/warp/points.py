"""The forward map: where points of the undeformed breast go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh
from simcore.kernels import njit, prange
from simcore.warp.maps import barycentric_weights

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

INSIDE = -1e-9
"""Least barycentric weight of a point that counts as inside: one on a shared face belongs to both sides."""
CELLS_PER_TET = 2.0


@dataclass(frozen=True, eq=False)
class ForwardMap:
    """Affine maps of all tetrahedra, and the cells of a coarse lattice with the tetrahedra that may lie in each.

    weights: (m, 4, 4): weight of node n at the point p, mm, is w[n, 0] + w[n, 1:] . p
    nodes: (n, 3) after compression, mm; deformed: (m, 4, 3) those of each tetrahedron.
    ratio: (m,) volume after over volume before.
    corner, edge, shape: of the lattice (x, y, z). start, members: tetrahedra of cell c, ascending:
    members[start[c]:start[c + 1]].
    """

    weights: Floats
    nodes: Floats
    deformed: Floats
    ratio: Floats
    corner: Floats
    edge: float
    shape: Indices
    start: Indices
    members: Indices

    @classmethod
    def of(cls, mesh: TetMesh, deformed: Floats) -> ForwardMap:
        """deformed: (n, 3) positions of the nodes after compression, mm."""
        corners, after = mesh.nodes[mesh.tets], deformed[mesh.tets]
        weights = barycentric_weights(corners)
        ratio = np.linalg.det(after[:, 1:] - after[:, :1]) / np.linalg.det(corners[:, 1:] - corners[:, :1])
        low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        edge = float((np.prod(high - low) / (CELLS_PER_TET * len(corners))) ** (1 / 3))
        shape = np.maximum(np.ceil((high - low) / edge), 1).astype(np.int64)
        boxes = np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)
        cells = np.clip(np.floor((boxes - low) / edge).astype(np.int64), 0, shape - 1)
        start, members = _cells(cells, shape)
        return cls(weights, deformed, after, ratio, low, edge, shape, start, members)

    def tets(self, points: Floats) -> Indices:
        """(p,) the tetrahedron of each point (p, 3), mm; from outside the one it is least outside of."""
        return np.asarray(
            _locate(points, self.weights, self.corner, self.edge, self.shape, self.start, self.members), np.int64
        )

    def moved(self, points: Floats, tets: Indices) -> Floats:
        """(p, 3) where points go by the maps of ``tets``, mm."""
        weights = self.weights[tets]
        shares = weights[:, :, 0] + np.einsum("pna,pa->pn", weights[:, :, 1:], points)
        return np.asarray(np.einsum("pn,pna->pa", shares, self.deformed[tets]))


@njit(cache=True)
def _cells(cells: Indices, shape: Indices) -> tuple[Indices, Indices]:
    """Tetrahedra by cell. cells: (m, 2, 3) first and last cell of each tetrahedron's box."""
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for fill in range(2):
        if fill == 1:
            start = np.cumsum(start)
            members = np.empty(start[-1], np.int64)
            position = start[:-1].copy()
        for m in range(len(cells)):
            for k in range(cells[m, 0, 2], cells[m, 1, 2] + 1):
                for j in range(cells[m, 0, 1], cells[m, 1, 1] + 1):
                    for i in range(cells[m, 0, 0], cells[m, 1, 0] + 1):
                        cell = (k * shape[1] + j) * shape[0] + i
                        if fill == 0:
                            start[cell + 1] += 1
                        else:
                            members[position[cell]] = m
                            position[cell] += 1
    return start, members


@njit(parallel=True, cache=True, error_model="numpy")
def _locate(
    points: Floats, weights: Floats, corner: Floats, edge: float, shape: Indices, start: Indices, members: Indices
) -> Indices:
    result = np.empty(len(points), np.int64)
    for p in prange(len(points)):
        cell = np.int64(0)
        for axis in range(2, -1, -1):
            at = np.int64(np.floor((points[p, axis] - corner[axis]) / edge))
            cell = cell * shape[axis] + min(max(at, 0), shape[axis] - 1)
        best, least = -1, -np.inf
        for entry in range(start[cell], start[cell + 1]):
            value = _least_weight(weights[members[entry]], points[p])
            if value > least:
                best, least = int(members[entry]), value
        if least < INSIDE:
            for m in range(len(weights)):
                value = _least_weight(weights[m], points[p])
                if value > least:
                    best, least = m, value
        result[p] = best
    return result


@njit(cache=True, error_model="numpy")
def _least_weight(weight: Floats, point: Floats) -> float:
    least = np.inf
    for n in range(4):
        value = weight[n, 0] + weight[n, 1] * point[0] + weight[n, 2] * point[1] + weight[n, 3] * point[2]
        least = min(least, value)
    return least
