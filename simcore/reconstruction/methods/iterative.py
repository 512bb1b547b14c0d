"""What iterative reconstructions share: the measurement, subsets of views, start, stopping rule, the stored volume.

The volume that is iterated covers the bounding box of the breast alone; voxels beyond it hold nothing. Memory: that
volume once as float32, the line integrals of all views, and the residuals of one subset.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack, Volume
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.core.progress import Progress, part, silent
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.filter.line_integrals import line_integrals, measured_pixels
from simcore.reconstruction.grids import breast_grid, wanted_grid
from simcore.reconstruction.kinds.backprojection import Backprojection
from simcore.reconstruction.kinds.common import IterativeSpec
from simcore.reconstruction.kinds.fbp import FilteredBackprojection
from simcore.reconstruction.methods import method_of
from simcore.reconstruction.methods.fbp import check
from simcore.reconstruction.methods.volumes import volume_report
from simcore.reconstruction.operators.backprojection import quantise_slices
from simcore.reconstruction.operators.crossings import Crossings, crossings_of
from simcore.reconstruction.operators.total_variation import denoise_slices

FloatArray = NDArray[np.float32]
COLUMNS = 64


@dataclass(frozen=True)
class Measurement:
    """Line integrals on a detector at rest, and how their rays cross the slices.

    integrals: float32 (views, ny, nx), NaN where nothing was measured.
    """

    integrals: FloatArray
    crossings: Crossings

    @property
    def grid(self) -> Grid:
        return self.crossings.grid

    @property
    def geometry(self) -> AcquisitionGeometry:
        return self.crossings.geometry


Correction = Callable[[FloatArray, NDArray[np.int64]], float]
"""Corrects a volume, in place, by a subset of views; returns the misfit of these views before."""


def iterate(
    stack: ProjectionStack,
    spec: IterativeSpec,
    iterations: int,
    views_per_subset: int,
    body: Body,
    corrected_by: Callable[[Measurement], Correction],
    progress: Progress = silent,
) -> Volume:
    """Corrects a volume subset by subset until the stopping rule or the number of iterations ends it.

    corrected_by: makes the correction for a measurement.
    returns: see ``simcore.reconstruction.reconstruct``; report: misfit before every iteration, and why it ended.
    """
    geometry = stack.geometry
    whole = volume_grid(geometry, spec, body)
    check(geometry, whole, in_plane=False)
    measurement = measure(stack, breast_grid(stack, whole))
    correct = corrected_by(measurement)
    volume = _start(stack, spec, body, measurement.grid, part(progress, 0.0, 0.1))
    subsets = subsets_of(geometry.angles, views_per_subset)
    misfits: list[float] = []
    ended = "iterations"
    for iteration in range(iterations):
        misfit = 0.0
        for index, subset in enumerate(subsets):
            done = (iteration + index / len(subsets)) / iterations
            progress(0.1 + 0.85 * done, f"iteration {iteration + 1} of {iterations}, subset {index + 1}")
            misfit += correct(volume, subset)
        if spec.total_variation > 0:
            denoise_slices(volume, spec.total_variation / measurement.grid.spacing[0], spec.total_variation_steps)
        misfits.append(misfit)
        if len(misfits) > 1 and abs(misfits[-2] - misfit) < spec.tolerance * misfits[-2]:
            ended = "tolerance"
            break
    result = _stored(volume, measurement.grid, wanted_grid(stack, spec, whole), spec)
    result.report.update(iterations=len(misfits), subsets=len(subsets), misfit=misfits, ended_by=ended)
    progress(1.0, "reconstructed")
    return result


def measure(stack: ProjectionStack, grid: Grid) -> Measurement:
    """The line integrals whose rays meet the volume.

    Where voxels are several pixels wide, so many pixels are averaged.
    """
    geometry = stack.geometry
    detector = geometry.detector
    binning = max(1, math.floor(grid.spacing[0] / detector.pixel + 1e-6))
    while detector.ny % binning:
        binning -= 1
    source_x, _, source_z = geometry.sources.T
    reach = float(np.max(source_x + (grid.upper[0] - source_x) * source_z / (source_z - grid.upper[2])))
    nx = max(1, min(detector.nx // binning, math.ceil(reach / detector.pixel / binning) + 1))
    binned = Detector(detector.ny // binning, nx, detector.pixel * binning)
    integrals = np.empty((geometry.views, binned.ny, nx), np.float32)
    for view in range(geometry.views):
        for start in range(0, nx, COLUMNS):
            stop = min(start + COLUMNS, nx)
            columns = slice(start * binning, stop * binning)
            values = line_integrals(stack, view, columns)
            if not geometry.at_rest(view):
                values[~measured_pixels(geometry, view, columns)] = np.nan
            pixels = values.reshape(binned.ny, binning, stop - start, binning)
            integrals[view, :, start:stop] = pixels.mean(axis=(1, 3))
    at_rest = replace(geometry, detector=binned, detector_angles=np.zeros(geometry.views), detector_poses=None)
    return Measurement(integrals, crossings_of(grid, at_rest))


def subsets_of(angles: NDArray[np.float64], size: int) -> list[NDArray[np.int64]]:
    """Views in subsets of ``size`` or less, each spread over the whole range, in an order in which neighbours differ
    much (steps of the golden section, as T. Koehler, IEEE NSS-MIC (2004) 3961)."""
    order = np.argsort(angles, kind="stable")
    count = math.ceil(len(angles) / min(size, len(angles)))
    stride = max(1, round(count * (math.sqrt(5.0) - 1.0) / 2.0))
    while math.gcd(stride, count) != 1:
        stride += 1
    return [order[(n * stride) % count :: count] for n in range(count)]


def _start(stack: ProjectionStack, spec: IterativeSpec, body: Body, grid: Grid, progress: Progress) -> FloatArray:
    """The volume that the iteration starts from, float32 (nz, ny, nx) on ``grid``."""
    if spec.start == "zero":
        return np.zeros(grid.shape, np.float32)
    kind = Backprojection if spec.start == "backprojection" else FilteredBackprojection
    first = kind(slice_mm=spec.slice_mm, pixel_mm=spec.pixel_mm, field="breast")
    volume = method_of(first)(stack, first, body, progress)
    start = volume.data.astype(np.float32)
    start *= np.float32(volume.slope)
    start += np.float32(volume.intercept)
    return np.maximum(start, np.float32(0.0), out=start)


def _stored(values: FloatArray, grid: Grid, target: Grid, spec: IterativeSpec) -> Volume:
    """Quantised on the wanted grid; zero where it reaches beyond ``grid``, whose voxels it shares."""
    shift = np.rint((np.array(grid.corner) - target.corner) / grid.spacing).astype(np.int64)[::-1].copy()
    data = np.empty(target.shape, np.uint16)
    low, high = quantise_slices(values, shift, spec.value_slope, spec.value_intercept, data)
    return Volume(data, target, spec.value_slope, spec.value_intercept, volume_report(target, low, high))
