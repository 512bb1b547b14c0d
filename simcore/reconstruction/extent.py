"""Where the voxels of a reconstruction lie; nothing here loads a kernel."""

from __future__ import annotations

from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.reconstruction.body import Body
from simcore.reconstruction.kinds.common import RegionSpec, VolumeSpec

SHADOW_MARGIN_MM = 2.0
"""So much more than what all views see of the breast is reconstructed where its box is asked for."""


def volume_grid(geometry: AcquisitionGeometry, spec: VolumeSpec, body: Body) -> Grid:
    """Slices from the breast support upwards over the area of the detector; the last may pass the paddle. Where tissue
    reaches beyond the plates there are more of them, but none below the detector.

    raises: GeometryError for a thickness that is not positive.
    """
    if not body.thickness > 0:
        raise GeometryError(f"thickness of the breast is {body.thickness} mm; it must be above 0 mm")
    detector = geometry.detector
    pixel = detector.pixel if spec.pixel_mm is None else spec.pixel_mm
    # The margin keeps 60 mm / 1 mm at 60 slices where the quotient is rounded upwards.
    nx = ceil(detector.nx * detector.pixel / pixel - 1e-6)
    ny = ceil(detector.ny * detector.pixel / pixel - 1e-6)
    below = min(ceil(body.below / spec.slice_mm - 1e-6), floor(geometry.support_height / spec.slice_mm + 1e-6))
    nz = below + ceil((body.thickness + body.above) / spec.slice_mm - 1e-6)
    corner = (0.0, -ny * pixel / 2, geometry.support_height - below * spec.slice_mm)
    return Grid((nz, ny, nx), (pixel, pixel, spec.slice_mm), corner)


def in_region(grid: Grid, region: RegionSpec, support_height: float) -> Grid:
    """The voxels of ``grid`` (detector frame) that a region touches. raises: GeometryError where there are none."""
    lift = np.array([0.0, 0.0, support_height])
    return within(grid, np.array(region.lower()) + lift, np.array(region.upper()) + lift)


def within(grid: Grid, low: NDArray[np.float64], high: NDArray[np.float64]) -> Grid:
    """The voxels of ``grid`` that the box between two corners (x, y, z), mm, touches.

    raises: GeometryError where there are none.
    """
    corner, counts = [], []
    for axis in range(3):
        spacing, size = grid.spacing[axis], grid.shape[2 - axis]
        ends = (np.array([low[axis], high[axis]]) - grid.corner[axis]) / spacing
        # The margin keeps a bound between two voxels from touching both.
        first = int(np.clip(np.floor(ends[0] + 1e-6), 0, size))
        stop = int(np.clip(np.ceil(ends[1] - 1e-6), 0, size))
        if first >= stop:
            raise GeometryError(
                f"the region from {low[axis]:g} to {high[axis]:g} mm along {'xyz'[axis]} holds no voxel of the field, "
                f"which reaches from {grid.corner[axis]:g} to {grid.upper[axis]:g} mm in the detector frame"
            )
        corner.append(grid.corner[axis] + first * spacing)
        counts.append(stop - first)
    return Grid((counts[2], counts[1], counts[0]), grid.spacing, (corner[0], corner[1], corner[2]))
