"""The discretised body: what stays the same during a compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, TetMesh
from simcore.fem.assembly import shape_gradients
from simcore.fem.materials.law import ConstitutiveLaw

Floats = NDArray[np.float64]
_N_PER_KPA_MM2 = 1e-3
_UPPER_PAIRS = [(a, b) for a in range(4) for b in range(a, 4)]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the blocks of a symmetric matrix stand: the upper half, row by row, the diagonal block first.

    row_start: int32 (n + 1,). column: int32 (blocks,).
    block_of: int32 (m, 10), block of each pair a <= b of corners of a tetrahedron.
    """

    row_start: NDArray[np.int32]
    column: NDArray[np.int32]
    block_of: NDArray[np.int32]

    @classmethod
    def of(cls, tets: NDArray[np.int64], node_count: int) -> Pattern:
        """tets: int64 (m, 4), each row ascending."""
        keys = np.stack([tets[:, a] * node_count + tets[:, b] for a, b in _UPPER_PAIRS], axis=1)
        unique, inverse = np.unique(keys, return_inverse=True)
        per_row = np.bincount(unique // node_count, minlength=node_count)
        return cls(
            row_start=np.concatenate([[0], np.cumsum(per_row)]).astype(np.int32),
            column=(unique % node_count).astype(np.int32),
            block_of=inverse.reshape(-1, len(_UPPER_PAIRS)).astype(np.int32),
        )


@dataclass(frozen=True, eq=False)
class Model:
    """Linear tetrahedra with a pressure at every node.

    nodes: (n, 3), mm. tets: int64 (m, 4), each row ascending (so of any orientation).
    gradients: (m, 4, 3) of the shape functions, 1/mm. volumes: (m,), mm^3.
    parameters: (m, 2) shear and bulk modulus of each element, N/mm^2.
    node_volume: (n,), a quarter of the tetrahedra around each node, mm^3.
    node_bulk: (n,) bulk modulus averaged over the same volume, N/mm^2.
    """

    nodes: Floats
    tets: NDArray[np.int64]
    gradients: Floats
    volumes: Floats
    parameters: Floats
    node_volume: Floats
    node_bulk: Floats
    pattern: Pattern

    @classmethod
    def of(cls, mesh: TetMesh, parameters: Floats) -> Model:
        """parameters: (m, 2) shear and bulk modulus of each element, kPa."""
        count = len(mesh.nodes)
        tets = np.sort(mesh.tets, axis=1)
        gradients, volumes = shape_gradients(mesh.nodes, tets)
        stress = parameters * _N_PER_KPA_MM2
        node_volume = _lumped(tets, volumes, count)
        return cls(
            nodes=mesh.nodes,
            tets=tets,
            gradients=gradients,
            volumes=volumes,
            parameters=stress,
            node_volume=node_volume,
            node_bulk=_lumped(tets, volumes * stress[:, 1], count) / node_volume,
            pattern=Pattern.of(tets, count),
        )

    def volume_ratio_of_pressure(self, pressure: Floats) -> tuple[Floats, Floats]:
        """(J, dJ/dp) at the nodes, the inverse of p = kappa U'(J) = kappa/2 (J - 1/J); pressure in N/mm^2, positive
        in tension."""
        t = pressure / self.node_bulk
        root = np.sqrt(t * t + 1)
        return t + root, (1 + t / root) / self.node_bulk


def element_parameters(mesh: TetMesh, phantom: Phantom, law: ConstitutiveLaw) -> Floats:
    """(m, 2) shear and bulk modulus of each element, kPa: one homogeneous law."""
    return np.tile(np.array(law.moduli()), (len(mesh.tets), 1))


def _lumped(tets: NDArray[np.int64], values: NDArray[Any], node_count: int) -> Floats:
    """A quarter of each element's value at each of its nodes."""
    return np.bincount(tets.ravel(), np.repeat(values / 4, 4), node_count).astype(np.float64, copy=False)
