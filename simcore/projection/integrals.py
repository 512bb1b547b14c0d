"""Line integrals of one view, by the method that the physics asks for."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.tissues import MAX_TISSUES
from simcore.projection import plane_prefix, plane_prefix_rows, rays
from simcore.projection.borders import Borders, borders_of


def line_integrals(
    phantom: Phantom,
    geometry: AcquisitionGeometry,
    view: int,
    mu: NDArray[np.float64],
    *,
    sampling: Literal["exact", "trilinear"] = "exact",
    step_voxels: float = 0.45,
    borders: Borders | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Integral of the attenuation coefficient from the source to every pixel centre of one view.

    phantom: in the support frame; it is lifted by geometry.support_height.
    mu: (MAX_TISSUES,), 1/mm, e.g. of ``materials.attenuation_table``.
    sampling: exact intersection lengths, or trilinear samples every ``step_voxels`` of the smallest voxel edge.
    borders: of the labels, where they are known already.
    returns: float32 (detector.ny, detector.nx), dimensionless; ``out`` where it is given.
    """
    grid = phantom.grid.moved(z=geometry.support_height)
    detector = geometry.detector
    if out is None:
        out = np.empty((detector.ny, detector.nx), np.float32)
    if sampling == "exact" and plane_prefix.serves(geometry, view):
        borders = borders or borders_of(phantom.labels)
        plane_prefix.project_planes(borders, grid, geometry, view, mu[None], out[None])
    else:
        step = step_voxels * min(grid.spacing) if sampling == "trilinear" else 0.0
        rays.project_rays(phantom.labels, grid, geometry, view, mu, step_mm=step, out=out)
    return out


def basis_integrals(
    phantom: Phantom,
    geometry: AcquisitionGeometry,
    view: int,
    basis: NDArray[np.float64],
    *,
    borders: Borders | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Exact integrals of several maps from the source to every pixel centre of one view, in one pass over the labels.

    basis: (maps, MAX_TISSUES), what each map gives each label, e.g. path lengths of basis materials; 1 to 4 maps.
    borders: of the labels, where they are known already.
    returns: float32 (maps, detector.ny, detector.nx), in units of basis times mm; ``out`` where it is given.
    raises: ValueError for another number of maps. Where the detector is at rest the one pass finds the borders between
        tissues, and each map follows from these; views that plane prefixes cannot serve take a pass for each map.
    """
    if basis.ndim != 2 or not 1 <= len(basis) <= plane_prefix_rows.MAPS or basis.shape[1] != MAX_TISSUES:
        raise ValueError(
            f"basis has the shape {basis.shape}; 1 to {plane_prefix_rows.MAPS} maps of {MAX_TISSUES} labels are served"
        )
    detector = geometry.detector
    grid = phantom.grid.moved(z=geometry.support_height)
    if out is None:
        out = np.empty((len(basis), detector.ny, detector.nx), np.float32)
    if plane_prefix.serves(geometry, view):
        plane_prefix.project_planes(borders or borders_of(phantom.labels), grid, geometry, view, basis, out)
    else:
        for values, one in zip(basis, out, strict=True):
            rays.project_rays(phantom.labels, grid, geometry, view, values, out=one)
    return out
