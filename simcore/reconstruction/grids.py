"""Which voxels are reconstructed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack
from simcore.core.grid import Grid
from simcore.kernels import njit, prange
from simcore.reconstruction.extent import SHADOW_MARGIN_MM, in_region, within
from simcore.reconstruction.kinds.common import VolumeSpec

SHADOW_SIGNAL = 0.9
"""Pixels below this part of the open field are in the breast's shadow: grazing rays through the skin lose far more."""


def wanted_grid(stack: ProjectionStack, spec: VolumeSpec, whole: Grid) -> Grid:
    """The part of ``whole`` that field and region ask for; its voxels are voxels of ``whole``.

    raises: GeometryError where no voxel is left.
    """
    grid = breast_grid(stack, whole) if spec.field == "breast" else whole
    return grid if spec.region is None else in_region(grid, spec.region, stack.geometry.support_height)


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
    return within(
        whole,
        np.array([-np.inf, low_y - margin, -np.inf]),
        np.array([high_x + margin, high_y + margin, np.inf]),
    )


def _shadow_mm(stack: ProjectionStack, view: int) -> tuple[float, float, float] | None:
    """(y min, y max, x max) of a view's shadow on the plane z = 0, mm; infinite where it touches the detector's edge,
    None where there is none."""
    geometry = stack.geometry
    detector = geometry.detector
    ends = _row_ends_of_shadow(stack, view)
    rows = np.flatnonzero(ends)
    if len(rows) == 0:
        return None
    first, last, columns = int(rows[0]), int(rows[-1]), int(ends.max())
    origin, row_direction = geometry.detector_frame(view)
    column_direction = geometry.column_direction(view)
    source = geometry.sources[view]
    on_plane = []
    for row in (first, last + 1):
        for column in (0, columns):
            point = origin + (row - detector.ny / 2) * detector.pixel * row_direction
            point = point + column * detector.pixel * column_direction
            on_plane.append(source + (point - source) * (source[2] / (source[2] - point[2])))
    x, y, _ = np.transpose(on_plane)
    low, high, far = first == 0, last == detector.ny - 1, columns == detector.nx
    if column_direction[0] != 1.0:
        low = high = far = low or high or far
    return -np.inf if low else float(y.min()), np.inf if high else float(y.max()), np.inf if far else float(x.max())


def _row_ends_of_shadow(stack: ProjectionStack, view: int) -> NDArray[np.int64]:
    """See ``_shadow_ends``; behind plates the open field is darker, the more the more oblique the ray."""
    signal, open_field = stack.data[view], stack.open_field
    if stack.slab_integral == 0:
        return np.asarray(_shadow_ends(signal, SHADOW_SIGNAL * open_field))
    behind_plates = open_field * np.exp(-stack.slab_integral * stack.geometry.obliquity(view))
    return np.asarray(_shadow_ends((signal >= SHADOW_SIGNAL * behind_plates).astype(np.uint16), 0.5))


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
