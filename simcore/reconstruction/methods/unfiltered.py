"""Back-projection without a filter: along the rays, or by shifting and adding whole projections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.progress import Progress, part, silent
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.filter.filters import chord_weights
from simcore.reconstruction.filter.line_integrals import line_integrals, lit_columns
from simcore.reconstruction.grids import wanted_grid
from simcore.reconstruction.kinds.backprojection import Backprojection
from simcore.reconstruction.methods.fbp import check
from simcore.reconstruction.methods.volumes import backprojected_volume, seen_columns
from simcore.reconstruction.operators.backprojection import BackprojectionPlan, plan_backprojection

FloatArray = NDArray[np.float32]


def unfiltered_backprojection(
    stack: ProjectionStack, spec: Backprojection, body: Body, progress: Progress = silent
) -> Volume:
    """See ``simcore.reconstruction.reconstruct``.

    A voxel's value is the mean over views of line integral / length of the ray between the plates, interpolated
    bilinearly where its ray meets the detector; beyond the detector the line integral counts as zero. A slab that fills
    the volume comes out with its own attenuation.
    """
    geometry = stack.geometry
    whole = volume_grid(geometry, spec, body)
    check(geometry, whole)
    grid = wanted_grid(stack, spec, whole)
    plan = plan_backprojection(geometry, grid) if spec.method == "simple" else plan_shift_and_add(geometry, grid)
    plan = replace(plan, weight=np.full_like(plan.weight, 1.0 / geometry.views))
    columns = min(lit_columns(stack) if geometry.stationary else geometry.detector.nx, seen_columns(plan, grid))
    means = mean_attenuation(stack, columns, body.thickness, part(progress, 0.0, 0.2))
    return backprojected_volume(means, plan, grid, spec, part(progress, 0.2, 1.0))


def mean_attenuation(stack: ProjectionStack, columns: int, thickness_mm: float, progress: Progress) -> FloatArray:
    """Line integrals over the length of their ray between the plates, float32 (views, ny, columns), 1/mm."""
    geometry = stack.geometry
    means = np.empty((geometry.views, geometry.detector.ny, columns), np.float32)
    for view in range(geometry.views):
        progress(view / geometry.views, f"reading view {view + 1} of {geometry.views}")
        np.multiply(
            line_integrals(stack, view, slice(0, columns)),
            chord_weights(geometry, view, slice(0, columns), thickness_mm),
            out=means[view],
        )
    return means


def plan_shift_and_add(geometry: AcquisitionGeometry, grid: Grid) -> BackprojectionPlan:
    """One magnification for all views of a slice, and for each view the shift that its middle has.

    L. T. Niklason and others, "Digital tomosynthesis in breast imaging", Radiology 205 (1997) 399.
    """
    detector = geometry.detector
    heights = grid.centres("z")[:, None]
    source_y, source_z = geometry.sources[:, 1], geometry.sources[:, 2]
    of_view = source_z / (source_z - heights)
    of_slice = of_view.mean(axis=1, keepdims=True)
    first_x, first_y = grid.centres("x")[0], grid.centres("y")[0]
    shift = source_y * (1.0 - of_view)
    return BackprojectionPlan(
        order=np.arange(geometry.views),
        group_start=np.array([0, geometry.views], np.int64),
        row_offset=(first_y * of_slice + shift) / detector.pixel + (detector.ny - 1) / 2,
        row_step=np.broadcast_to(of_slice * grid.spacing[1] / detector.pixel, of_view.shape).copy(),
        column_offset=first_x * of_slice / detector.pixel - 0.5,
        column_step=of_slice * grid.spacing[0] / detector.pixel,
        weight=np.ones(of_view.shape, np.float32),
    )
