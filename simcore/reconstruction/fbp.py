"""Filtered back-projection of a tomosynthesis acquisition."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from math import ceil

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.progress import Progress, silent
from simcore.reconstruction.backprojection import backproject_quantised, plan_backprojection
from simcore.reconstruction.filters import (
    angular_steps,
    filter_columns,
    frequency_response,
    padded_length,
    ray_weights,
)
from simcore.reconstruction.lanes import ROWS
from simcore.reconstruction.line_integrals import line_integrals, lit_columns
from simcore.reconstruction.spec import FilteredBackprojection

FloatArray = NDArray[np.float32]
COLUMNS = 64
"""Detector columns filtered together. Fixed, so that results do not depend on the number of threads."""


def filtered_backprojection(
    stack: ProjectionStack, spec: FilteredBackprojection, thickness_mm: float, progress: Progress = silent
) -> Volume:
    """See ``simcore.reconstruction.reconstruct``; formulas and normalisation stand in ``filters``.

    Voxel-driven, bilinear on the detector, zero beyond its edges. A limited angular range loses low frequencies: the
    inside of a wide object comes out near zero and its edges along y are pronounced. At the centre of an elliptic
    cylinder with semi-axes a (y) and b (z) the value is 2 / pi atan(b / a tan(range / 2)) of the true one; away from
    the centre it changes with depth, as the fans of the missing views do not cancel.
    """
    geometry = stack.geometry
    grid = volume_grid(geometry, spec, thickness_mm)
    _check(geometry, grid)
    filtered = filtered_views(stack, spec, float(np.mean(grid.centres("z"))), progress)

    plan = plan_backprojection(geometry, grid)
    data = np.empty(grid.shape, np.uint16)
    ny = grid.shape[1]
    step = ROWS * max(1, ceil(ny / ROWS / 16))
    low = high = 0
    for start in range(0, ny, step):
        rows = slice(start, min(start + step, ny))
        progress(0.35 + 0.65 * start / ny, f"backprojecting row {start} of {ny}")
        clipped = backproject_quantised(filtered, plan, rows, spec.value_slope, spec.value_intercept, data)
        low, high = low + clipped[0], high + clipped[1]
    progress(1.0, "reconstructed")
    report = {
        "slices": grid.shape[0],
        "slice_mm": grid.spacing[2],
        "pixel_mm": grid.spacing[0],
        "clipped_voxels": low + high,
        "clipped_low_voxels": low,
        "clipped_high_voxels": high,
    }
    return Volume(data, grid, spec.value_slope, spec.value_intercept, report)


def volume_grid(geometry: AcquisitionGeometry, spec: FilteredBackprojection, thickness_mm: float) -> Grid:
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


def _check(geometry: AcquisitionGeometry, grid: Grid) -> None:
    if geometry.views < 2 or np.ptp(geometry.angles) <= 0:
        raise GeometryError(
            f"filtered back-projection needs views at two angles at least; there are {geometry.views} view(s) over "
            f"{np.ptp(geometry.angles):g} degrees: raise views or angular_range_degrees"
        )
    lowest = float(geometry.sources[:, 2].min())
    if grid.upper[2] >= lowest:
        raise GeometryError(
            f"the slices reach z = {grid.upper[2]:g} mm, the source {lowest:g} mm: lower the thickness or the "
            "angular range, or raise source_to_detector_mm"
        )
    if np.any(np.abs(geometry.sources[:, 0]) > 1e-9):
        raise GeometryError(
            f"source at x = {geometry.sources[:, 0].max():g} mm; filtered back-projection needs the tube to turn in "
            "the plane of the chest wall, x = 0 mm"
        )


def filtered_views(
    stack: ProjectionStack, spec: FilteredBackprojection, z_middle: float, progress: Progress = silent
) -> FloatArray:
    """Line integrals of every view, weighted and filtered along y, times the view's angular step.

    z_middle: height of the volume's middle, mm, where the slice thickness filter is exact.
    returns: float32 (views, ny, columns), 1/mm; columns beyond the last that holds signal are left out.
    """
    geometry = stack.geometry
    ny = geometry.detector.ny
    columns = lit_columns(stack) if geometry.stationary else geometry.detector.nx
    filtered = np.empty((geometry.views, ny, columns), np.float32)
    threads = numba.get_num_threads()
    with ThreadPoolExecutor(threads) as pool:
        for view in range(geometry.views):
            progress(0.35 * view / geometry.views, f"filtering view {view + 1} of {geometry.views}")
            _filter_view(stack, spec, view, z_middle, filtered[view], pool)
    return filtered


def _filter_view(
    stack: ProjectionStack,
    spec: FilteredBackprojection,
    view: int,
    z_middle: float,
    filtered: FloatArray,
    pool: ThreadPoolExecutor,
) -> None:
    """Fill float32 (ny, columns) of one view, some columns at a time."""
    geometry = stack.geometry
    _, source_y, source_z = geometry.sources[view]
    length = padded_length(geometry.detector.ny)
    response = np.float32(angular_steps(geometry.angles)[view]) * frequency_response(
        length,
        geometry.detector.pixel,
        spec,
        tan_angle=source_y / (source_z - geometry.isocenter_height),
        magnification=source_z / (source_z - z_middle),
    )

    def filter_block(start: int) -> None:
        columns = slice(start, min(start + COLUMNS, filtered.shape[1]))
        weighted = line_integrals(stack, view, columns)
        weighted *= ray_weights(geometry, view, columns)
        filtered[:, columns] = filter_columns(weighted, response, length)

    list(pool.map(filter_block, range(0, filtered.shape[1], COLUMNS)))
