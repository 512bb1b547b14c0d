"""Compression of the breast between two plates: nonlinear finite elements."""

from __future__ import annotations

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.progress import Progress, silent
from simcore.fem.spec import CompressionSpec

__all__ = ["CompressionSpec", "compress"]


def compress(mesh: TetMesh, phantom: Phantom, spec: CompressionSpec, progress: Progress = silent) -> Compression:
    """The equilibrium of ``mesh`` between two rigid, frictionless plates.

    mesh: tetrahedra in the breast frame, mm; its wall nodes are held along x and free along y and z.
    phantom: the labels the mesh was made from; laws that differ from tissue to tissue read them.
    spec: wanted compression, percent of the extent along z, material, tolerance.
    returns: Compression; forces in N. The plates have moved by the same distance towards the middle.
    raises: SolverError (code "inverted-element" or "not-converged") with what to change.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.fem.compression import compress_mesh

    return compress_mesh(mesh, phantom, spec, progress)
