"""From a label volume to tetrahedra: outline, tetrahedralization, cleaning, quality."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.mesh.spec import LatticeMesh, MeshSpec, TetwildMesh

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import Phantom, TetMesh

__all__ = ["LatticeMesh", "MeshSpec", "TetwildMesh", "build", "reads_tissues"]


def reads_tissues(spec: MeshSpec) -> bool:
    """Whether a mesh depends on the tissues inside the outline."""
    return isinstance(spec, TetwildMesh) and spec.border_refinement > 1


def build(phantom: Phantom, spec: MeshSpec, progress: Progress = silent) -> TetMesh:
    """Tetrahedra that fill everything but air of ``phantom``, in front of the chest wall x = 0.

    phantom: labels uint8 (nz, ny, nx) in the breast frame; x = 0 must be a face between two voxel layers (or the
        outer face of the first one).
    spec: which mesher, wanted edge length, mm, for 700 ml, and the tolerance of the outline.
    returns: TetMesh; its wall nodes have x == 0.0, its volume is that of the labels.
    raises: MeshError where the labels have no body at the chest wall or the mesher fails.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.mesh.builder import build_mesh

    return build_mesh(phantom, spec, progress)
