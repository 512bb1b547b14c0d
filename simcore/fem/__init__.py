"""Compression of the breast between two plates: nonlinear finite elements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simcore.core.progress import Progress, silent
from simcore.fem.laws import MaterialSpec
from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.laws.published import Published
from simcore.fem.spec import CompressionSpec

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import Compression, Phantom, TetMesh

__all__ = ["CompressionSpec", "compress", "reads_tissues", "write_vtu"]


def reads_tissues(spec: CompressionSpec) -> bool:
    """Whether a compression depends on the tissues in the mesh."""
    return isinstance(spec.material, ByTissue | Published)


def compress(mesh: TetMesh, phantom: Phantom, spec: CompressionSpec, progress: Progress = silent) -> Compression:
    """The equilibrium of ``mesh`` between two plates, by default rigid and without friction.

    mesh: tetrahedra in the breast frame, mm; its wall nodes are held along x and, by default, free along y and z.
    phantom: the labels the mesh was made from; laws that differ from tissue to tissue read them.
    spec: wanted compression, materials, plates, chest wall.
    returns: Compression; forces in N. The plates have moved by the same distance towards the middle.
    raises: SolverError with what to change; on the way of the plates a simcore.fem.newton.outcome.CompressionFailed
    with the last good state. Codes: simcore.fem.newton.outcome.FAULTS, "no-chest-wall", "mixed-strains", "no-muscle".
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.fem.compression import compress_mesh

    return compress_mesh(mesh, phantom, spec, progress)


def write_vtu(
    path: Path,
    mesh: TetMesh,
    compression: Compression,
    phantom: Phantom | None = None,
    material: MaterialSpec | None = None,
) -> None:
    """The uncompressed mesh with its displacement, strains and stresses, in the breast frame, for ParaView and others.

    At the nodes: displacement_mm. In the tetrahedra: J = det F, green_lagrange_strain (nine components, row by row).
    With ``phantom``: fraction_NAME of every tissue, tissue (the label of the largest). With ``phantom`` and
    ``material`` (that of the compression): cauchy_stress_kPa (nine components), von_mises_stress_kPa, and at the
    nodes pressure_kPa, positive in compression. Single precision.
    """
    from simcore.fem.report.vtu import write_mesh

    write_mesh(path, mesh, compression, phantom, material)
