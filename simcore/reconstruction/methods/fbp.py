"""Filtered back-projection of a tomosynthesis acquisition."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of, where
from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.progress import Progress, part, silent
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.filter.edges import Profile, thickness_profile
from simcore.reconstruction.filter.filters import (
    angular_steps,
    chord_weights,
    filter_columns,
    frequency_response,
    padded_length,
    ray_weights,
)
from simcore.reconstruction.filter.line_integrals import line_integrals, lit_columns
from simcore.reconstruction.grids import wanted_grid
from simcore.reconstruction.kinds.fbp import FilteredBackprojection
from simcore.reconstruction.methods.volumes import backprojected_volume, seen_columns
from simcore.reconstruction.operators.backprojection import plan_backprojection
from simcore.reconstruction.operators.lanes import padded_width

FloatArray = NDArray[np.float32]
COLUMNS = 64
"""Detector columns filtered together. Fixed, so that results do not depend on the number of threads."""


def filtered_backprojection(
    stack: ProjectionStack, spec: FilteredBackprojection, body: Body, progress: Progress = silent
) -> Volume:
    """See ``simcore.reconstruction.reconstruct``; formulas and normalisation stand in ``filters``.

    Voxel-driven, bilinear on the detector, zero beyond its edges. A limited angular range loses low frequencies: the
    inside of a wide object comes out near zero and its edges along y are pronounced. At the centre of an elliptic
    cylinder with semi-axes a (y) and b (z) the value is 2 / pi atan(b / a tan(range / 2)) of the true one; away from
    the centre it changes with depth, as the fans of the missing views do not cancel.
    """
    geometry = stack.geometry
    whole = volume_grid(geometry, spec, body)
    check(geometry, whole)
    grid = wanted_grid(stack, spec, whole)
    plan = plan_backprojection(geometry, grid)
    if spec.filter == "none":
        plan = replace(plan, weight=np.ones_like(plan.weight))
    filtered = filtered_views(stack, spec, whole, body.thickness, seen_columns(plan, grid), part(progress, 0.0, 0.35))
    return backprojected_volume(filtered, plan, grid, spec, part(progress, 0.35, 1.0))


def check(geometry: AcquisitionGeometry, grid: Grid, in_plane: bool = True) -> None:
    """
    in_plane: whether the sources must stand in the plane of the chest wall.
    raises: GeometryError where no volume can be made of these views.
    """
    if geometry.views < 2 or np.ptp(geometry.angles) <= 0:
        raise GeometryError(
            f"a volume needs views at two angles at least; there are {geometry.views} view(s) over "
            f"{np.ptp(geometry.angles):g} degrees: take "
            + one_of(where(geometry.views < 2, "more views"), "a larger angular_range_degrees")
        )
    lowest = float(geometry.sources[:, 2].min())
    if grid.upper[2] >= lowest:
        raise GeometryError(
            f"the slices reach z = {grid.upper[2]:g} mm, the source {lowest:g} mm: lower the thickness or the "
            "angular range, or raise source_to_detector_mm"
        )
    farthest = max(geometry.sources[:, 0], key=abs)
    if in_plane and abs(farthest) > 1e-9:
        raise GeometryError(
            f"source at x = {farthest:g} mm; back-projection needs the tube to turn in the plane "
            "of the chest wall, x = 0 mm; an iterative reconstruction takes any trajectory"
        )


def filtered_views(
    stack: ProjectionStack,
    spec: FilteredBackprojection,
    whole: Grid,
    thickness_mm: float,
    columns: int | None = None,
    progress: Progress = silent,
) -> FloatArray:
    """Line integrals of every view, weighted and filtered along y, times the view's angular step.

    whole: the volume; the slice thickness filter is exact in its middle. thickness_mm: of the breast.
    columns: of the detector that are needed; all of them where not given.
    returns: float32 (views, ny, columns), 1/mm; columns beyond the last that holds signal are left out but for a few
        of zeros, so that rows begin at whole vectors.
    """
    geometry = stack.geometry
    detector = geometry.detector
    lit = lit_columns(stack) if geometry.stationary else detector.nx
    count = lit if columns is None else min(lit, columns)
    padded = np.empty((geometry.views, detector.ny, padded_width(count)), np.float32)
    padded[:, :, count:] = 0.0
    filtered = padded[:, :, :count]
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for view in range(geometry.views):
            progress(view / geometry.views, f"filtering view {view + 1} of {geometry.views}")
            _filter_view(stack, spec, view, whole, thickness_mm, filtered[view], pool)
    return padded


def _filter_view(
    stack: ProjectionStack,
    spec: FilteredBackprojection,
    view: int,
    whole: Grid,
    thickness_mm: float,
    filtered: FloatArray,
    pool: ThreadPoolExecutor,
) -> None:
    """Fill float32 (ny, columns) of one view, some columns at a time."""
    geometry = stack.geometry
    _, source_y, source_z = geometry.sources[view]
    steps = angular_steps(geometry.angles)
    length = padded_length(geometry.detector.ny)
    response = frequency_response(
        length,
        geometry.detector.pixel,
        spec,
        tan_angle=source_y / (source_z - geometry.isocenter_height),
        magnification=source_z / (source_z - float(np.mean(whole.centres("z")))),
    )
    if spec.filter == "none":
        response *= np.float32(steps[view] / steps.sum())
    else:
        response *= np.float32(steps[view])
    profile = thickness_profile(stack, view, filtered.shape[1]) if spec.breast_edge == "flatten" else None

    def filter_block(start: int) -> None:
        columns = slice(start, min(start + COLUMNS, filtered.shape[1]))
        weighted = _weighted(stack, spec, view, columns, thickness_mm, profile)
        filter_columns(weighted, response, length, filtered[:, columns], extend=spec.detector_edge == "extend")

    list(pool.map(filter_block, range(0, filtered.shape[1], COLUMNS)))


def _weighted(
    stack: ProjectionStack,
    spec: FilteredBackprojection,
    view: int,
    columns: slice,
    thickness_mm: float,
    profile: Profile | None,
) -> FloatArray:
    """Line integrals of some columns, float32 (ny, columns), ready for the filter."""
    weighted = line_integrals(stack, view, columns)
    if profile is not None:
        profile.take_from(weighted, columns)
    if spec.filter == "none":
        weighted *= chord_weights(stack.geometry, view, columns, thickness_mm)
    else:
        weighted *= ray_weights(stack.geometry, view, columns)
    return weighted
