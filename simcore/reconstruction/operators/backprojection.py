"""Voxel-driven backprojection onto slices parallel to the detector, quantised as it is made.

The source has x = 0 in every view and slices lie parallel to the detector. So one voxel row (z, y) reads two
neighbouring detector rows (one pair of weights for the whole row), and along x it reads at positions that depend on
the slice and the height of the source alone. Views with a source at the same height (the tube angles +a and -a) share
those positions: their rows are added first and resampled along x once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.kernels import njit, prange
from simcore.reconstruction.operators.interpolation import row_weights
from simcore.reconstruction.operators.lanes import ROWS, add_resampled_rows, padded_width, padding
from simcore.simd.vector import LANES, fma, load, splat, store, times

FloatArray = NDArray[np.float32]
Coordinates = NDArray[np.float64]


@dataclass(frozen=True)
class BackprojectionPlan:
    """Where voxels read the detector, in pixels.

    order:       int64 (views,), views sorted so that those of one source height are neighbours.
    group_start: int64 (groups + 1,), first view (in that order) of each group.
    row_offset, row_step: float64 (nz, views), voxel row y reads detector row row_offset + y * row_step.
    column_offset, column_step: float64 (nz, groups), the same along x.
    weight:      float32 (nz, views), factor of a view in a slice: the square of the magnification.
    """

    order: NDArray[np.int64]
    group_start: NDArray[np.int64]
    row_offset: NDArray[np.float64]
    row_step: NDArray[np.float64]
    column_offset: NDArray[np.float64]
    column_step: NDArray[np.float64]
    weight: FloatArray


def plan_backprojection(geometry: AcquisitionGeometry, grid: Grid) -> BackprojectionPlan:
    """The plan for a detector at rest and a volume grid in the detector frame."""
    detector = geometry.detector
    heights = np.round(geometry.sources[:, 2], 9)
    order = np.argsort(heights, kind="stable")
    group_start = np.concatenate([np.flatnonzero(np.diff(heights[order], prepend=np.nan) != 0), [len(order)]])

    source_y, source_z = geometry.sources[order, 1], geometry.sources[order, 2]
    magnification = source_z / (source_z - grid.centres("z")[:, None])
    first_x, first_y = grid.centres("x")[0], grid.centres("y")[0]
    on_detector_y = source_y + (first_y - source_y) * magnification
    of_group = magnification[:, group_start[:-1]]
    return BackprojectionPlan(
        order=order,
        group_start=group_start.astype(np.int64),
        row_offset=on_detector_y / detector.pixel + (detector.ny - 1) / 2,
        row_step=magnification * grid.spacing[1] / detector.pixel,
        column_offset=first_x * of_group / detector.pixel - 0.5,
        column_step=of_group * grid.spacing[0] / detector.pixel,
        weight=(magnification**2).astype(np.float32),
    )


def backproject_quantised(
    filtered: FloatArray, plan: BackprojectionPlan, rows: slice, slope: float, intercept: float, out: NDArray[np.uint16]
) -> tuple[int, int]:
    """Fill voxel rows ``rows`` (y) of every slice of ``out``.

    filtered: float32 (views, ny, columns); pixels beyond its edges count as zero. Copied unless the number of columns
        is one of ``padded_width``.
    out: uint16 (nz, ny, nx): round((attenuation - intercept) / slope), clipped to 0..65535.
    returns: number of voxels clipped at (0, 65535).
    """
    clipped = np.zeros((-(-(rows.stop - rows.start) // ROWS), 2), np.int64)
    beside = padded_width(filtered.shape[2]) - filtered.shape[2]
    _backproject_rows(
        np.pad(filtered, ((0, 0), (0, 0), (0, beside))) if beside else filtered,
        plan.order,
        plan.group_start,
        plan.row_offset,
        plan.row_step,
        plan.column_offset,
        plan.column_step,
        plan.weight,
        padding(float(plan.column_step.max())),
        padded_width(out.shape[2]),
        np.float32(1.0 / slope),
        np.float32(-intercept / slope),
        (rows.start, rows.stop),
        out,
        clipped,
    )
    return int(clipped[:, 0].sum()), int(clipped[:, 1].sum())


@njit(cache=True, parallel=True, error_model="numpy")
def _backproject_rows(
    filtered: FloatArray,
    order: NDArray[np.int64],
    group_start: NDArray[np.int64],
    row_offset: Coordinates,
    row_step: Coordinates,
    column_offset: Coordinates,
    column_step: Coordinates,
    weight: FloatArray,
    pad: int,
    width: int,
    scale: np.float32,
    shift: np.float32,
    row_range: tuple[int, int],
    out: NDArray[np.uint16],
    clipped: NDArray[np.int64],
) -> None:
    """``backproject_quantised`` for blocks of ROWS voxel rows, each of which belongs to one thread."""
    nz, _, nx = out.shape
    _, detector_rows, columns = filtered.shape
    pixels = filtered.reshape(-1)
    for block in prange(clipped.shape[0]):
        y0 = row_range[0] + block * ROWS
        count = min(ROWS, row_range[1] - y0)
        summed = np.zeros((ROWS, columns + 2 * pad), np.float32)
        flat = summed.reshape(-1)
        attenuation = np.empty((ROWS, width), np.float32)
        low = high = 0
        for z in range(nz):
            attenuation[:] = 0.0
            for group in range(len(group_start) - 1):
                for r in range(count):
                    # Two views at a time, mostly those of the tube angles +a and -a.
                    for k in range(group_start[group], group_start[group + 1], 2):
                        places, weights = _rows_of(k, order, row_offset, row_step, weight, z, y0 + r, detector_rows)
                        if k + 1 < group_start[group + 1]:
                            more = _rows_of(k + 1, order, row_offset, row_step, weight, z, y0 + r, detector_rows)
                        else:
                            more = places, (np.float32(0.0), np.float32(0.0))
                        kept = np.float32(k > group_start[group])
                        goal = r * summed.shape[1] + pad
                        lower, upper = places[0] * columns, places[1] * columns
                        further_lower, further_upper = more[0][0] * columns, more[0][1] * columns
                        _mix(
                            pixels,
                            (lower, upper, further_lower, further_upper),
                            (weights[0], weights[1], more[1][0], more[1][1]),
                            flat,
                            goal,
                            kept,
                            columns,
                        )
                add_resampled_rows(summed, pad, column_offset[z, group], column_step[z, group], 1.0, attenuation)
            for r in range(count):
                below, above = _quantise(attenuation[r, :nx], scale, shift, out[z, y0 + r])
                low += below
                high += above
        clipped[block, 0] = low
        clipped[block, 1] = high


@njit(forceinline=True, error_model="numpy")
def _mix(
    source: FloatArray,
    places: tuple[int, int, int, int],
    weights: tuple[np.float32, np.float32, np.float32, np.float32],
    target: FloatArray,
    goal: int,
    kept: np.float32,
    count: int,
) -> None:
    """target[goal + i] = kept target[goal + i] + sum over n of weights[n] source[places[n] + i], i < count and up to
    whole vectors."""
    rest = splat(kept, LANES)
    w0, w1 = splat(weights[0], LANES), splat(weights[1], LANES)
    w2, w3 = splat(weights[2], LANES), splat(weights[3], LANES)
    for i in range(0, count, LANES):
        total = times(rest, load(target, goal + i, LANES))
        total = fma(w0, load(source, places[0] + i, LANES), total)
        total = fma(w1, load(source, places[1] + i, LANES), total)
        total = fma(w2, load(source, places[2] + i, LANES), total)
        total = fma(w3, load(source, places[3] + i, LANES), total)
        store(target, goal + i, total)


@njit(cache=True, error_model="numpy")
def _rows_of(
    k: int,
    order: NDArray[np.int64],
    row_offset: Coordinates,
    row_step: Coordinates,
    weight: FloatArray,
    z: int,
    y: int,
    detector_rows: int,
) -> tuple[tuple[int, int], tuple[np.float32, np.float32]]:
    """The two rows, counted over all views, that the k-th view gives voxel row (z, y), and their weights."""
    first, second, lower, upper = row_weights(row_offset[z, k] + y * row_step[z, k], detector_rows)
    before = order[k] * detector_rows
    return (before + first, before + second), (np.float32(lower * weight[z, k]), np.float32(upper * weight[z, k]))


def quantise_slices(
    values: FloatArray, shift: NDArray[np.int64], slope: float, intercept: float, out: NDArray[np.uint16]
) -> tuple[int, int]:
    """Fill ``out`` with attenuation as it is stored, zero where there is no value.

    values: float32 (nz, ny, nx); shift: (z, y, x) of its first voxel in ``out``, uint16, of any size.
    returns: number of voxels clipped at (0, 65535).
    """
    clipped = np.zeros((out.shape[0], 2), np.int64)
    scale, offset = np.float32(1.0 / slope), np.float32(-intercept / slope)
    _quantise_slices(values, (int(shift[0]), int(shift[1]), int(shift[2])), scale, offset, out, clipped)
    return int(clipped[:, 0].sum()), int(clipped[:, 1].sum())


@njit(cache=True, parallel=True, error_model="numpy")
def _quantise_slices(
    values: FloatArray,
    first: tuple[int, int, int],
    scale: np.float32,
    shift: np.float32,
    out: NDArray[np.uint16],
    clipped: NDArray[np.int64],
) -> None:
    nz, ny, nx = values.shape
    start, stop = max(first[2], 0), min(first[2] + nx, out.shape[2])
    for z in prange(out.shape[0]):
        row = np.empty(out.shape[2], np.float32)
        for y in range(out.shape[1]):
            k, j = z - first[0], y - first[1]
            row[:] = np.float32(0.0)
            if 0 <= k < nz and 0 <= j < ny and start < stop:
                row[start:stop] = values[k, j, start - first[2] : stop - first[2]]
            below, above = _quantise(row, scale, shift, out[z, y])
            clipped[z, 0] += below
            clipped[z, 1] += above


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _quantise(
    attenuation: FloatArray, scale: np.float32, shift: np.float32, out: NDArray[np.uint16]
) -> tuple[int, int]:
    """out = attenuation * scale + shift, rounded and clipped. Returns how many were clipped at 0 and at 65535."""
    low = high = 0
    for i in range(len(out)):
        value = attenuation[i] * scale + shift + np.float32(0.5)
        low += value < np.float32(0.0)
        high += value >= np.float32(65536.0)
        out[i] = np.uint16(np.int32(min(max(value, np.float32(0.0)), np.float32(65535.0))))
    return low, high
