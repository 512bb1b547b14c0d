"""Which voxels are reconstructed."""

from __future__ import annotations

from math import ceil

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.reconstruction.kinds.common import VolumeSpec

SHADOW_SIGNAL = 0.9
"""Pixels below this part of the open field are in the breast's shadow: grazing rays through the skin lose far more."""
SHADOW_MARGIN_MM = 2.0


def volume_grid(geometry: AcquisitionGeometry, spec: VolumeSpec, thickness_mm: float) -> Grid:
    """Slices from the breast support upwards over the area of the detector; the last may pass the paddle.

    raises: GeometryError for a thickness that is not positive.
    """
    if not thickness_mm > 0:
        raise GeometryError(f"thickness of the breast is {thickness_mm} mm; it must be above 0 mm")
    detector = geometry.detector
    pixel = detector.pixel if spec.pixel_mm is None else spec.pixel_mm
    # The margin keeps 60 mm / 1 mm at 60 slices where the quotient is rounded upwards.
    nx = ceil(detector.nx * detector.pixel / pixel - 1e-6)
    ny = ceil(detector.ny * detector.pixel / pixel - 1e-6)
    nz = ceil(thickness_mm / spec.slice_mm - 1e-6)
    corner = (0.0, -ny * pixel / 2, geometry.support_height)
    return Grid((nz, ny, nx), (pixel, pixel, spec.slice_mm), corner)


def wanted_grid(stack: ProjectionStack, spec: VolumeSpec, whole: Grid) -> Grid:
    """The part of ``whole`` that field and region ask for; its voxels are voxels of ``whole``.

    raises: GeometryError where no voxel is left.
    """
    grid = breast_grid(stack, whole) if spec.field == "breast" else whole
    if spec.region is not None:
        low, high = spec.region.lower(), spec.region.upper()
        lift = np.array([0.0, 0.0, stack.geometry.support_height])
        grid = _within(grid, low + lift, high + lift)
    return grid


def breast_grid(stack: ProjectionStack, whole: Grid) -> Grid:
    """The part of ``whole`` over which all views see the breast's shadow, and 2 mm more; ``whole`` without a shadow."""
    shadows = [_shadow_mm(stack, view) for view in range(stack.geometry.views)]
    if any(s is None for s in shadows):
        return whole
    y_low, y_high, x_high = (np.array(bounds) for bounds in zip(*(s for s in shadows if s is not None), strict=True))
    source_x, source_y, source_z = stack.geometry.sources.T
    # Seen from a source, a bound on the detector lies at this share of its way from the source's foot.
    shrink = 1.0 - whole.centres("z")[:, None] / source_z
    low_y = np.min(np.max(source_y + (y_low - source_y) * shrink, axis=1))
    high_y = np.max(np.min(source_y + (y_high - source_y) * shrink, axis=1))
    high_x = np.max(np.min(source_x + (x_high - source_x) * shrink, axis=1))
    margin = SHADOW_MARGIN_MM
    if low_y - margin >= high_y + margin:
        return whole
    return _within(
        whole,
        np.array([-np.inf, low_y - margin, -np.inf]),
        np.array([high_x + margin, high_y + margin, np.inf]),
    )


def _shadow_mm(stack: ProjectionStack, view: int) -> tuple[float, float, float] | None:
    """(y min, y max, x max) of a view's shadow on the plane z = 0, mm; infinite where it touches the detector's edge,
    None where there is none."""
    detector = stack.geometry.detector
    ends = _shadow_ends(stack.data[view], SHADOW_SIGNAL * stack.open_field)
    rows = np.flatnonzero(ends)
    if len(rows) == 0:
        return None
    first, last, columns = int(rows[0]), int(rows[-1]), int(ends.max())
    origin, row_direction = stack.geometry.detector_frame(view)
    source = stack.geometry.sources[view]

    def on_plane(y: float) -> tuple[float, float]:
        """y on z = 0 of the ray to a point on the detector, and the factor of its x."""
        point = origin + y * row_direction
        share = source[2] / (source[2] - point[2])
        return float(source[1] + (point[1] - source[1]) * share), float(share)

    (y_low, share_low), (y_high, share_high) = (
        on_plane((edge - detector.ny / 2) * detector.pixel) for edge in (first, last + 1)
    )
    return (
        -np.inf if first == 0 else y_low,
        np.inf if last == detector.ny - 1 else y_high,
        np.inf if columns == detector.nx else columns * detector.pixel * max(share_low, share_high),
    )


@njit(cache=True, parallel=True)
def _shadow_ends(view: NDArray[np.uint16], limit: float) -> NDArray[np.int64]:
    """One more than the last column below ``limit`` in every row of uint16 (ny, nx); 0 where there is none."""
    ny, nx = view.shape
    ends = np.zeros(ny, np.int64)
    for j in prange(ny):
        end = nx
        while end > 0 and view[j, end - 1] >= limit:
            end -= 1
        ends[j] = end
    return ends


def _within(grid: Grid, low: NDArray[np.float64], high: NDArray[np.float64]) -> Grid:
    """The voxels of ``grid`` that the box between two corners (x, y, z), mm, touches."""
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
