"""Projection of a stack of slices, and its exact transpose: the pair that iterative reconstructions need.

Joseph's method (P. M. Joseph, IEEE Trans. Med. Imaging 1 (1982) 192) with slices as the main planes: a ray crosses
every slice at its middle plane, the slice is interpolated bilinearly there, and the values are summed times the length
of the ray within one slice. Voxels beyond the volume are zero. ``backproject`` has the same weights, transposed:
<project_slices(x), y> = <x, backproject(y)>. (The backprojection inside filtered_backprojection is another one: it
interpolates on the detector, once a voxel.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.reconstruction.operators.lanes import padded_width, padding
from simcore.reconstruction.operators.slice_kernels import Gathering, backproject_views, project_view

FloatArray = NDArray[np.float32]
Coordinates = NDArray[np.float64]


@dataclass(frozen=True)
class Crossings:
    """Where rays cross slices: the ray to pixel [j, i] of a view passes slice z at voxel row
    offsets[view, z, 0] + j steps[view, z, 0] and voxel column offsets[view, z, 1] + i steps[view, z, 1] (fractions).

    offsets, steps: float64 (views, nz, 2).
    """

    offsets: Coordinates
    steps: Coordinates
    grid: Grid
    geometry: AcquisitionGeometry

    def project(self, volume: FloatArray, view: int, projection: FloatArray) -> None:
        """Sums of the interpolated slices along the rays of a view, without lengths.

        volume: float32 (nz, ny, nx). projection: float32 (ny, nx), overwritten.
        """
        pad = padding(float(self.steps[view, :, 1].max()))
        width = padded_width(projection.shape[1])
        project_view(volume, self.offsets[view], self.steps[view], pad, width, projection)

    def gathering(self, views: NDArray[np.int64]) -> Gathering:
        """How the transpose reads projections of these views: float32 (len(views), ny, nx) in that order."""
        offsets, steps = self.offsets[views], self.steps[views]
        sources = np.round(self.geometry.sources[views][:, [0, 2]], 9)
        order = np.lexsort(sources.T)
        changes = np.any(np.diff(sources[order], axis=0) != 0, axis=1)
        group_start = np.concatenate([[0], np.flatnonzero(changes) + 1, [len(order)]])
        reach = float(1.0 / steps[:, :, 1].min())
        return order, group_start, offsets, steps, padding(reach, reach), padded_width(self.grid.shape[2])

    def ray_lengths(self, view: int) -> FloatArray:
        """Length of every ray of a view within one slice, mm, float32 (ny, nx)."""
        x, y, z = self.geometry.sources[view]
        detector = self.geometry.detector
        across = (detector.y_centres() - y)[:, None] ** 2 + (detector.x_centres() - x) ** 2
        return np.asarray(self.grid.spacing[2] * np.sqrt(across + z**2) / z, np.float32)


def crossings_of(grid: Grid, geometry: AcquisitionGeometry) -> Crossings:
    """
    raises: GeometryError for a detector that turns, or a volume not between detector and source.
    """
    if not geometry.stationary:
        raise GeometryError("the detector turns with the tube; project_slices and backproject need one at rest")
    lowest = float(geometry.sources[:, 2].min())
    if grid.corner[2] < 0 or grid.upper[2] >= lowest:
        raise GeometryError(
            f"the volume lies at z = {grid.corner[2]:g} to {grid.upper[2]:g} mm; it must lie between the detector, "
            f"0 mm, and the lowest source, {lowest:g} mm"
        )
    detector = geometry.detector
    source = geometry.sources[:, None, :]
    shrink = 1.0 - grid.centres("z") / source[:, :, 2]
    steps = np.empty((geometry.views, grid.shape[0], 2))
    offsets = np.empty_like(steps)
    for axis, first, start in ((1, detector.y_centres()[0], 0), (0, detector.x_centres()[0], 1)):
        crossing = source[:, :, axis] + (first - source[:, :, axis]) * shrink
        offsets[:, :, start] = (crossing - grid.corner[axis]) / grid.spacing[axis] - 0.5
        steps[:, :, start] = detector.pixel * shrink / grid.spacing[axis]
    return Crossings(offsets, steps, grid, geometry)


def project_slices(volume: FloatArray, grid: Grid, geometry: AcquisitionGeometry) -> FloatArray:
    """Line integrals of a volume.

    volume: float32 (nz, ny, nx), attenuation, 1/mm. grid: where its voxels lie, detector frame.
    returns: float32 (views, ny, nx) on the detector, no unit.
    raises: GeometryError for a detector that turns, or a volume not between detector and source.
    """
    crossings = crossings_of(grid, geometry)
    if volume.shape != grid.shape:
        raise ValueError(f"volume {volume.shape} and grid {grid.shape} differ")
    detector = geometry.detector
    projections = np.empty((geometry.views, detector.ny, detector.nx), np.float32)
    slices = np.ascontiguousarray(volume, np.float32)
    for view in range(geometry.views):
        crossings.project(slices, view, projections[view])
        projections[view] *= crossings.ray_lengths(view)
    return projections


def backproject(projections: FloatArray, grid: Grid, geometry: AcquisitionGeometry) -> FloatArray:
    """The transpose of ``project_slices``.

    projections: float32 (views, ny, nx). returns: float32 (nz, ny, nx), mm.
    raises: GeometryError for a detector that turns, or a volume not between detector and source.
    """
    crossings = crossings_of(grid, geometry)
    detector = geometry.detector
    if projections.shape != (geometry.views, detector.ny, detector.nx):
        raise ValueError(f"projections {projections.shape} do not fit {geometry.views} views of {detector}")
    lengthened = np.stack([projections[view] * crossings.ray_lengths(view) for view in range(geometry.views)])
    volume = np.empty(grid.shape, np.float32)
    backproject_views(lengthened, crossings.gathering(np.arange(geometry.views)), volume)
    return volume
