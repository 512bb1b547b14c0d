"""Line integrals of one view, by the method that the physics asks for."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry
from simcore.projection import coverage, plane_prefix, rays


def line_integrals(
    phantom: Phantom,
    geometry: AcquisitionGeometry,
    view: int,
    mu: NDArray[np.float64],
    *,
    sampling: Literal["exact", "trilinear"] = "exact",
    step_voxels: float = 0.45,
    ends: NDArray[np.int32] | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Integral of the attenuation coefficient from the source to every pixel centre of one view.

    phantom: in the support frame; it is lifted by geometry.support_height.
    mu: (MAX_TISSUES,), 1/mm, e.g. of ``materials.attenuation_table``.
    sampling: exact intersection lengths, or trilinear samples every ``step_voxels`` of the smallest voxel edge.
    ends: of ``coverage.row_ends``, where it is known already.
    returns: float32 (detector.ny, detector.nx), dimensionless; ``out`` where it is given.
    """
    grid = phantom.grid.moved(z=geometry.support_height)
    detector = geometry.detector
    if out is None:
        out = np.empty((detector.ny, detector.nx), np.float32)
    if sampling == "exact" and plane_prefix.serves(geometry, view):
        if ends is None:
            ends = coverage.row_ends(phantom.labels, mu)
        plane_prefix.project_planes(phantom.labels, ends, grid, geometry, view, mu, out)
    else:
        step = step_voxels * min(grid.spacing) if sampling == "trilinear" else 0.0
        rays.project_rays(phantom.labels, grid, geometry, view, mu, step_mm=step, out=out)
    return out
