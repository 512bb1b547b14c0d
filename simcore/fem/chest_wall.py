"""What holds the breast: a chest wall that is free in its plane, one that is held altogether, or the muscle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.fem.linear.tangent import Guard
from simcore.fem.plates.contact import Contact
from simcore.fem.plates.edge import PlateEdge
from simcore.fem.spec import CompressionSpec
from simcore.fem.tissues import tissue_fractions

_MUSCLE_SHARE = 0.5
"""Of a tetrahedron that counts as muscle."""


@dataclass(frozen=True, eq=False)
class Support:
    """fixed: bool (n, 3), degrees of freedom that keep their displacement. anchors: int64 (h,), nodes held altogether.
    guard: against drift and roll of a wall that is free in its plane."""

    fixed: NDArray[np.bool_]
    anchors: NDArray[np.int64]
    guard: Guard

    @classmethod
    def of(cls, mesh: TetMesh, phantom: Phantom, spec: CompressionSpec) -> Support:
        """raises: SpecError, code "no-muscle" where the muscle is to hold a breast that has none"""
        fixed = np.zeros(mesh.nodes.shape, dtype=bool)
        fixed[mesh.wall, 0] = True
        if spec.chest_wall == "free_in_plane":
            return cls(fixed, mesh.wall[:0], Guard.against_roll(mesh.nodes, mesh.wall))
        anchors = mesh.wall if spec.chest_wall == "fixed" else muscle_nodes(mesh, phantom)
        fixed[anchors] = True
        return cls(fixed, anchors, Guard.none())

    def contact(self, mesh: TetMesh) -> Contact:
        """No node on a plate; those that are held cannot come onto one."""
        return Contact.none(mesh.skin, len(mesh.nodes)).holding(mesh.wall).without(self.anchors)

    def plate_edge(self, mesh: TetMesh, width: float) -> PlateEdge | None:
        """The edge of the plates where the breast is held, none where its wall is free. width: mm."""
        if not len(self.anchors):
            return None
        return PlateEdge.of(mesh.nodes, np.intersect1d(self.anchors, np.unique(mesh.skin)), width)


def muscle_nodes(mesh: TetMesh, phantom: Phantom) -> NDArray[np.int64]:
    """Nodes of the tetrahedra that are muscle, as VICTRE holds them.

    Source: DIDSR/VICTRE_PIPELINE, Victre/compression/doc/operation.rst: tetrahedra of muscle are a fixed boundary.
    """
    muscle = tissue_fractions(mesh, phantom)[:, Tissue.MUSCLE] > _MUSCLE_SHARE
    nodes = np.unique(mesh.tets[muscle])
    if len(nodes) < 3:
        raise SpecError(
            "compression.chest_wall = 'fixed_muscle': the phantom has no muscle that fills a tetrahedron; take "
            "'free_in_plane' or 'fixed', a tissue map that has muscle, or a smaller mesh.edge_length_mm",
            code="no-muscle",
        )
    return nodes
