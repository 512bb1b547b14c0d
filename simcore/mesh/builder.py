"""The mesh stage."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of
from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.errors import MeshError
from simcore.core.progress import Progress, part
from simcore.mesh import lattice, tetwild
from simcore.mesh.cleaning import compacted, largest_body, oriented, snapped_to_wall, wall_and_skin
from simcore.mesh.ordering import cache_order
from simcore.mesh.quality import quality_report, volumes
from simcore.mesh.sizing import sizing_field
from simcore.mesh.spec import LatticeMesh, MeshSpec, TetwildMesh
from simcore.mesh.surface import Outline, outline

_MAX_VOLUME_ERROR = 0.05
"""More than the chords of a coarse mesh can cut off: the mesh is not that of the outline."""


LATTICE_CONSTANT_PER_EDGE = 1.146
"""Edge of the cubic cell over the wanted edge length: 35k tetrahedra at 5.5 mm, as with fTetWild."""

MIN_ANGLE_DEG = 10.0
"""Smallest dihedral angle that a lattice mesh may have; outlines of phantoms give 18."""


def build_mesh(phantom: Phantom, spec: MeshSpec, progress: Progress) -> TetMesh:
    """See simcore.mesh.build."""
    progress(0.0, "outline of the labels")
    surface = outline(phantom, spec.edge_length_mm)
    edge_length = spec.edge_length_mm * surface.scale
    if isinstance(spec, LatticeMesh):
        progress(0.1, "filling the outline")
        nodes, tets = lattice.stuffed(surface.field, LATTICE_CONSTANT_PER_EDGE * edge_length)
        nodes, tets = compacted(nodes, largest_body(nodes, tets))
    else:
        nodes, tets = _wild(phantom, surface, spec, edge_length, part(progress, 0.05, 0.9))
    progress(0.9, "numbering the mesh")
    nodes, volume_error = _with_volume(nodes, tets, surface.volume, spec)
    nodes, tets = cache_order(nodes, tets)
    wall, skin = wall_and_skin(nodes, tets)
    quality = quality_report(nodes, tets)
    smallest = quality["dihedral_angle_deg"]["min"]
    if isinstance(spec, LatticeMesh) and smallest < MIN_ANGLE_DEG:
        raise MeshError(
            f"the mesh has a dihedral angle of {smallest:.1f} degrees where {MIN_ANGLE_DEG:g} are the least: the "
            "outline is too rough for the lattice; smooth the labels, take another edge_length_mm or mesh.kind = "
            "'tetwild' (not with reproducible)",
            code="mesh-quality",
        )
    report = quality | {
        "mesher": spec.kind,
        "wanted_edge_length_mm": edge_length,
        "outline_triangles": len(surface.triangles),
        "volume_before_correction": 1 + volume_error,
        "wall_nodes": len(wall),
        "skin_faces": len(skin),
    }
    progress(1.0, f"{len(tets)} tetrahedra")
    return TetMesh(nodes, tets, wall, skin, report)


def _wild(
    phantom: Phantom, surface: Outline, spec: TetwildMesh, edge_length: float, progress: Progress
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """fTetWild's tetrahedra, positive and in one piece, the chest wall at x = 0 exactly."""
    nodes, tets = tetwild.tetrahedralize(
        surface.points,
        surface.triangles,
        edge_length=edge_length,
        epsilon=spec.epsilon,
        sizing=sizing_field(phantom, edge_length, spec.border_refinement) if spec.border_refinement > 1 else None,
        threads=numba.get_num_threads(),
        time_limit_s=spec.time_limit_s,
        progress=progress,
    )
    tets = largest_body(nodes, oriented(nodes, tets))
    tolerance = 3 * spec.epsilon * float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    return snapped_to_wall(*compacted(nodes, tets), tolerance)


def _with_volume(
    nodes: NDArray[np.float64], tets: NDArray[np.int64], volume: float, spec: MeshSpec
) -> tuple[NDArray[np.float64], float]:
    """The mesh scaled about the middle of its wall to the volume of the labels (flat faces cut the curved outline
    short), and the relative error it had before.

    raises: MeshError where more is missing than the chords explain, or a tetrahedron has no volume.
    """
    each = volumes(nodes, tets)
    error = float(each.sum() / volume - 1)
    if abs(error) > _MAX_VOLUME_ERROR or each.min() <= 0:
        raise MeshError(
            f"the mesh has {each.sum() / 1e3:.1f} ml where the labels have {volume / 1e3:.1f} ml, and its smallest "
            f"tetrahedron {each.min():.3g} mm^3; take {one_of(*spec.finer())}",
            code="mesh-volume",
        )
    on_wall = nodes[:, 0] == 0.0
    if not on_wall.any():
        raise MeshError(
            f"no node of the mesh lies on the chest wall; take {one_of(*spec.finer())}", code="mesh-no-wall"
        )
    centre = np.array([0.0, *nodes[on_wall, 1:].mean(axis=0)])
    return centre + (nodes - centre) * (1 + error) ** (-1 / 3), error
