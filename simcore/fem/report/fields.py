"""Strain and stress of the elements of a compression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simcore.core.artifacts import TetMesh
from simcore.fem.elements.model import Floats, Model
from simcore.fem.laws.of_elements import N_PER_KPA_MM2, ElementLaws


@dataclass(frozen=True, eq=False)
class Strain:
    """gradient: F (m, 3, 3). volume_ratio: J = det F (m,). green_lagrange: E = (F^T F - 1)/2 (m, 3, 3)."""

    gradient: Floats
    volume_ratio: Floats
    green_lagrange: Floats

    @classmethod
    def of(cls, mesh: TetMesh, displacement: Floats) -> Strain:
        """displacement: (n, 3), mm."""
        before, after = (_edges(points, mesh) for points in (mesh.nodes, mesh.nodes + displacement))
        F = after @ np.linalg.inv(before)
        return cls(F, np.linalg.det(F), 0.5 * (F.transpose(0, 2, 1) @ F - np.eye(3)))


@dataclass(frozen=True, eq=False)
class Stress:
    """Without the skin membrane. cauchy: (m, 3, 3), kPa. von_mises: (m,), kPa. pressure: (n,) at the nodes, kPa,
    positive in compression."""

    cauchy: Floats
    von_mises: Floats
    pressure: Floats

    @classmethod
    def of(cls, mesh: TetMesh, displacement: Floats, laws: ElementLaws) -> Stress:
        """displacement: (n, 3), mm."""
        model = Model.of(mesh, laws)
        tension = _nodal_tension(model, displacement)
        # With nodes of its own, each element shows its stress in its nodal forces: P = sum f_a (X_a - X_0) / V.
        corners = mesh.tets.ravel()
        apart = TetMesh(
            mesh.nodes[corners],
            np.arange(corners.size).reshape(-1, 4),
            np.empty(0, np.int64),
            np.empty((0, 3), np.int64),
        )
        alone = Model.of(apart, laws)
        force = alone.internal_force(displacement[corners], tension[corners]).reshape(-1, 4, 3)
        position = apart.nodes.reshape(-1, 4, 3)
        piola = force.transpose(0, 2, 1) @ (position - position[:, :1]) / alone.volumes[:, None, None]
        if laws.linear is not None and not laws.linear.large:
            cauchy = piola / N_PER_KPA_MM2
        else:
            strain = Strain.of(mesh, displacement)
            cauchy = piola @ strain.gradient.transpose(0, 2, 1) / strain.volume_ratio[:, None, None] / N_PER_KPA_MM2
        deviator = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        return cls(cauchy, np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))), -tension / N_PER_KPA_MM2)


def _edges(points: Floats, mesh: TetMesh) -> Floats:
    """(m, 3, 3), the edges from the first corner as columns."""
    corners = points[mesh.tets]
    edges: Floats = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    return edges


def _nodal_tension(model: Model, displacement: Floats) -> Floats:
    """kappa U'(J) of the volume averaged at the nodes, (n,), N/mm^2."""
    system = model.without_tangent()
    own = np.array(displacement)  # not read-only: that would be one more kernel to compile
    model.assemble(own, np.zeros(len(own)), system, with_tangent=False)
    ratio = system.node_volume / model.node_volume
    if model.laws.linear is not None:
        return model.node_bulk * (ratio - 1)
    return model.node_bulk / 2 * (ratio - 1 / ratio)
