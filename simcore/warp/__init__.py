"""The compressed label volume: the phantom carried along by the displacement of its mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.warp.spec import WarpSpec

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import Compression, Phantom, TetMesh

__all__ = ["WarpSpec", "deform"]


def deform(
    phantom: Phantom, mesh: TetMesh, compression: Compression, spec: WarpSpec, progress: Progress = silent
) -> Phantom:
    """The phantom after compression, by the inverse map: every voxel centre looks up its undeformed label. Lesions of
    few voxels that this would lose, join or change go by the forward map instead, as objects.

    phantom: labels uint8 (nz, ny, nx) in the breast frame. mesh, compression: of that phantom.
    returns: labels with the same voxel edges in the support frame: z = 0 is the lower plate, x = 0 the chest wall,
        y centred, the top the upper plate; where the body reaches beyond a plate (beside the rim of a fixed chest wall)
        so does the grid. Entries of ``truth`` with "centre_mm" have it carried along.
        report: volume_before_ml, volume_after_ml, tissue_before_ml, tissue_after_ml and tissue_expected_ml (by the
        volume changes of the tetrahedra) {name: ml}, mesh_volume_ml (deformed), skirt_ml (taken from outside the mesh),
        beyond_plates_mm [below, above] (of the grid), lesion_objects {tissue: {before, after, placed, merged, lost}},
        holes (air voxels with tissue on all six sides), grid.
    raises: SolverError (code "inverted-element") where the displacement turns a tetrahedron inside out, (code
        "tissue-lost") where tissue of more than 1 % of the breast is missing, beyond what counting voxels can miss;
        MeshError where the skin faces of the mesh are not faces of its tetrahedra.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.warp.stage import deform_phantom
    from simcore.warp.volumes import require_whole

    deformed = deform_phantom(phantom, mesh, compression, spec, progress)
    require_whole(deformed.report, spec)
    return deformed
