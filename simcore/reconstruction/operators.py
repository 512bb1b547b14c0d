"""Projection of a stack of slices, and its exact transpose: the pair that iterative reconstructions need.

Joseph's method (P. M. Joseph, IEEE Trans. Med. Imaging 1 (1982) 192) with slices as the main planes: a ray crosses
every slice at its middle plane, the slice is interpolated bilinearly there, and the values are summed times the length
of the ray within one slice. Voxels beyond the volume are zero. ``backproject`` has the same weights, transposed:
<project_slices(x), y> = <x, backproject(y)>. (The backprojection inside filtered_backprojection is another one: it
interpolates on the detector, once a voxel.)
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.reconstruction.interpolation import add_two_rows, row_weights
from simcore.reconstruction.lanes import ROWS, add_resampled_rows, padded_width, padding

FloatArray = NDArray[np.float32]
Coordinates = NDArray[np.float64]


def project_slices(volume: FloatArray, grid: Grid, geometry: AcquisitionGeometry) -> FloatArray:
    """Line integrals of a volume.

    volume: float32 (nz, ny, nx), attenuation, 1/mm. grid: where its voxels lie, detector frame.
    returns: float32 (views, ny, nx) on the detector, no unit.
    raises: GeometryError for a detector that turns, or a volume not between detector and source.
    """
    _check(grid, geometry)
    if volume.shape != grid.shape:
        raise ValueError(f"volume {volume.shape} and grid {grid.shape} differ")
    detector = geometry.detector
    projections = np.zeros((geometry.views, detector.ny, detector.nx), np.float32)
    offsets, steps = _crossings(grid, geometry)
    slices = np.ascontiguousarray(volume, np.float32)
    pad, width = padding(float(steps[:, :, 1].max())), padded_width(detector.nx)
    for view in range(geometry.views):
        _project_view(slices, offsets[view], steps[view], pad, width, projections[view])
        projections[view] *= _ray_lengths(grid, geometry, view)
    return projections


def backproject(projections: FloatArray, grid: Grid, geometry: AcquisitionGeometry) -> FloatArray:
    """The transpose of ``project_slices``.

    projections: float32 (views, ny, nx). returns: float32 (nz, ny, nx), mm.
    raises: GeometryError for a detector that turns, or a volume not between detector and source.
    """
    _check(grid, geometry)
    detector = geometry.detector
    if projections.shape != (geometry.views, detector.ny, detector.nx):
        raise ValueError(f"projections {projections.shape} do not fit {geometry.views} views of {detector}")
    volume = np.zeros(grid.shape, np.float32)
    offsets, steps = _crossings(grid, geometry)
    reach = float(1.0 / steps[:, :, 1].min())
    pad, width = padding(reach, reach), padded_width(grid.shape[2])
    padded = np.zeros((-(-detector.ny // ROWS) * ROWS, detector.nx + 2 * pad), np.float32)
    for view in range(geometry.views):
        padded[: detector.ny, pad : pad + detector.nx] = projections[view] * _ray_lengths(grid, geometry, view)
        _backproject_view(padded, pad, offsets[view], steps[view], width, volume)
    return volume


def _check(grid: Grid, geometry: AcquisitionGeometry) -> None:
    if not geometry.stationary:
        raise GeometryError("the detector turns with the tube; project_slices and backproject need one at rest")
    lowest = float(geometry.sources[:, 2].min())
    if grid.corner[2] < 0 or grid.upper[2] >= lowest:
        raise GeometryError(
            f"the volume lies at z = {grid.corner[2]:g} to {grid.upper[2]:g} mm; it must lie between the detector, "
            f"0 mm, and the lowest source, {lowest:g} mm"
        )


def _crossings(grid: Grid, geometry: AcquisitionGeometry) -> tuple[Coordinates, Coordinates]:
    """Where rays cross slices: the ray to pixel [j, i] passes a slice at voxel row offset[0] + j step[0] and column
    offset[1] + i step[1] (fractions). Both float64 (views, nz, 2)."""
    detector = geometry.detector
    source = geometry.sources[:, None, :]
    shrink = 1.0 - grid.centres("z") / source[:, :, 2]
    steps = np.empty((geometry.views, grid.shape[0], 2))
    offsets = np.empty_like(steps)
    for axis, first, start in ((1, detector.y_centres()[0], 0), (0, detector.x_centres()[0], 1)):
        crossing = source[:, :, axis] + (first - source[:, :, axis]) * shrink
        offsets[:, :, start] = (crossing - grid.corner[axis]) / grid.spacing[axis] - 0.5
        steps[:, :, start] = detector.pixel * shrink / grid.spacing[axis]
    return offsets, steps


def _ray_lengths(grid: Grid, geometry: AcquisitionGeometry, view: int) -> FloatArray:
    """Length of every ray within one slice, mm, float32 (ny, nx)."""
    x, y, z = geometry.sources[view]
    across = (geometry.detector.y_centres() - y)[:, None] ** 2 + (geometry.detector.x_centres() - x) ** 2
    return np.asarray(grid.spacing[2] * np.sqrt(across + z**2) / z, np.float32)


@njit(cache=True, parallel=True, error_model="numpy")
def _project_view(
    volume: FloatArray, offset: Coordinates, step: Coordinates, pad: int, width: int, projection: FloatArray
) -> None:
    """Fill float32 (ny, nx) of one view with sums over slices; ROWS detector rows belong to one thread."""
    nz, ny, nx = volume.shape
    detector_rows, columns = projection.shape
    for block in prange((detector_rows + ROWS - 1) // ROWS):
        j0 = block * ROWS
        count = min(ROWS, detector_rows - j0)
        crossed = np.zeros((ROWS, nx + 2 * pad), np.float32)
        sums = np.zeros((ROWS, width), np.float32)
        for z in range(nz):
            for r in range(count):
                row = crossed[r, pad : pad + nx]
                row[:] = 0.0
                first, second, lower, upper = row_weights(offset[z, 0] + (j0 + r) * step[z, 0], ny)
                add_two_rows(volume[z, first], volume[z, second], np.float32(lower), np.float32(upper), row)
            add_resampled_rows(crossed, pad, offset[z, 1], step[z, 1], 1.0, sums)
        projection[j0 : j0 + count] = sums[:count, :columns]


@njit(cache=True, parallel=True, error_model="numpy")
def _backproject_view(
    padded: FloatArray, pad: int, offset: Coordinates, step: Coordinates, width: int, volume: FloatArray
) -> None:
    """Add one view, float32 (rows, pad + nx + pad), to every slice; a slice belongs to one thread."""
    nz, ny, nx = volume.shape
    for z in prange(nz):
        spread = np.empty((ROWS, width), np.float32)
        for j0 in range(0, padded.shape[0], ROWS):
            spread[:] = 0.0
            first_column = -offset[z, 1] / step[z, 1]
            reach = 1.0 / step[z, 1]
            add_resampled_rows(padded[j0 : j0 + ROWS], pad, first_column, reach, reach, spread)
            for r in range(ROWS):
                first, second, lower, upper = row_weights(offset[z, 0] + (j0 + r) * step[z, 0], ny)
                _add_scaled(spread[r, :nx], np.float32(lower), volume[z, first])
                _add_scaled(spread[r, :nx], np.float32(upper), volume[z, second])


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _add_scaled(row: FloatArray, factor: np.float32, total: FloatArray) -> None:
    if factor != 0.0:
        for i in range(len(total)):
            total[i] += factor * row[i]
