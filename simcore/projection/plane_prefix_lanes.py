"""Plane prefixes (see ``plane_prefix``) of sixteen detector rows at a time, from the borders between tissues alone.

The differences E_b of two running sums grow only where tissue changes along x, and a voxel row of the breast has about
thirty such borders. And where the detector is at rest, all of its rows have their crossings at the same pixels, columns
and heights. So sixteen rows stand side by side in the lanes of a vector: a border adds to E with the weight of each
row's path in that voxel row, and a crossing takes one vector from E and gives it to one pixel of all sixteen.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange
from simcore.projection.borders import PLACE_SHIFT
from simcore.projection.crossings import Columns, Crossings, crossings_of
from simcore.projection.plane_prefix_rows import Rows
from simcore.simd.aligned import zeros
from simcore.simd.vector import LANES, fma, load, minimum, minus, plus, splat, store

FloatArray = NDArray[np.float32]

BorderLists = tuple[NDArray[np.int64], NDArray[np.uint32], FloatArray, int, int, int]
"""start and packed of ``Borders``; how mu falls at a border, see ``Borders.falls``; nz, ny, nx."""

FLATTEST = 0.999
"""Voxel rows that a path may pass in a slice: with less than one it turns once at most."""


@njit(parallel=True, cache=True, error_model="numpy")
def project_lanes(
    borders: BorderLists,
    rows: Rows,
    columns: Columns,
    order: NDArray[np.int64],
    reach: int,
    source_z: float,
    edge_z: float,
    out: FloatArray,
) -> None:
    """Line integrals of a view whose rows have one stretch and turn into one other voxel row at most in a slice.

    order: of the groups of LANES rows. reach: largest x end of tissue. out: float32 (rows, pixels), overwritten.
    """
    slices = borders[3]
    stretch = rows[2]
    tangent_x = columns[0] / source_z * stretch[0]
    squared = (tangent_x * tangent_x).astype(np.float32)
    crossings = crossings_of(columns, stretch[0], slices, reach)
    last = crossings[4]
    pixels = np.searchsorted(last, reach)  # columns at the top ascend: from here on rays pass beyond the tissue
    for task in prange(len(order)):
        first = order[task] * LANES
        count = min(LANES, len(stretch) - first)
        sums = zeros((borders[5] + 2) * LANES)
        image = zeros(len(last) * LANES)
        if _run_group(borders, rows, crossings, first, count, sums, image):
            _finish(sums, rows[3], last, squared, edge_z, first, count, pixels, image, out)
        else:
            out[first : first + count] = np.float32(0.0)


@njit(cache=True, error_model="numpy")
def _run_group(
    borders: BorderLists, rows: Rows, crossings: Crossings, first: int, count: int, sums: FloatArray, image: FloatArray
) -> bool:
    """Subtracts E_b(z_b) of every crossing from ``image``, pixel after pixel of LANES rows each; leaves E at the top of
    the volume in ``sums``. False where none of the rows meets a border.

    In a slice E grows linearly along a path that stays in one voxel row, and has a bend where it turns into the next.
    E is brought to the top of the slice first, and crossings go back from there."""
    # Tuples are taken apart here, once: every taking apart counts references.
    start, packed, falls, slices, depth, _ = borders
    event_start, pixel, boundary, fraction, _ = crossings
    bottom_y, top_y, _, _ = rows
    entered, left = zeros(len(sums)), zeros(len(sums))
    turn, grown, into, beyond = zeros(LANES), zeros(LANES), zeros(LANES), zeros(LANES)
    nothing, whole = splat(np.float32(0.0), LANES), splat(np.float32(1.0), LANES)
    at, then = np.full(LANES, -1, np.int64), np.full(LANES, -1, np.int64)
    turn[:] = np.float32(1.0)
    farthest = np.uint32(0)
    for k in range(slices):
        lowest, highest, turns = depth, -1, False
        for lane in range(count):
            slope = (top_y[first + lane] - bottom_y[first + lane]) / slices
            enter = bottom_y[first + lane] + slope * k
            column, final = math.floor(enter), math.floor(bottom_y[first + lane] + slope * (k + 1))
            at[lane], then[lane] = column, final
            turn[lane] = 1.0
            if column != final:
                turns = True
                turn[lane] = (max(column, final) - enter) / slope
            lowest, highest = min(lowest, column, final), max(highest, column, final)
        lowest, highest = max(lowest, 0), min(highest, depth - 1)
        for column in range(lowest, highest + 1):
            row = k * depth + column
            if start[row] == start[row + 1]:
                continue
            for lane in range(count):
                into[lane] = at[lane] == column
                beyond[lane] = then[lane] == column and at[lane] != column
                grown[lane] = turn[lane] * into[lane] + (np.float32(1.0) - turn[lane]) * beyond[lane]
            weight, weight_into, weight_beyond = load(grown, 0, LANES), load(into, 0, LANES), load(beyond, 0, LANES)
            for border in range(np.uint64(start[row]), np.uint64(start[row + 1])):
                b = np.int64(packed[border] >> np.uint32(PLACE_SHIFT)) * LANES
                fall = splat(falls[packed[border] & np.uint32(255)], LANES)
                store(sums, b, fma(fall, weight, load(sums, b, LANES)))
                store(entered, b, fma(fall, weight_into, load(entered, b, LANES)))
                if turns:
                    store(left, b, fma(fall, weight_beyond, load(left, b, LANES)))
            farthest = max(farthest, packed[start[row + 1] - 1] >> np.uint32(PLACE_SHIFT))
        if farthest == 0:
            continue
        heights = load(turn, 0, LANES)
        for event in range(np.uint64(event_start[k]), np.uint64(event_start[k + 1])):
            if boundary[event] > farthest:
                break
            b, v = np.int64(boundary[event]) * LANES, np.int64(pixel[event]) * LANES
            total = load(sums, b, LANES)
            if turns:
                # Each path leaves one voxel row for the next at its height ``turn`` within the slice (1: it does not).
                height = splat(fraction[event], LANES)
                before = minimum(height, heights)
                missing = minus(before, heights)  # of the part up to the turn, at most 0
                after = minus(minus(height, before), minus(whole, heights))
                total = fma(after, load(left, b, LANES), fma(missing, load(entered, b, LANES), total))
            else:
                total = fma(splat(fraction[event] - np.float32(1.0), LANES), load(entered, b, LANES), total)
            store(image, v, minus(load(image, v, LANES), total))
        for column in range(lowest, highest + 1):
            row = k * depth + column
            for border in range(np.uint64(start[row]), np.uint64(start[row + 1])):
                b = np.int64(packed[border] >> np.uint32(PLACE_SHIFT)) * LANES
                store(entered, b, nothing)
                if turns:
                    store(left, b, nothing)
    return bool(farthest > 0)


@njit(cache=True, error_model="numpy")
def _finish(
    sums: FloatArray,
    tangent_y: NDArray[np.float64],
    last: NDArray[np.int32],
    squared: FloatArray,
    edge_z: float,
    first: int,
    count: int,
    pixels: int,
    image: FloatArray,
    out: FloatArray,
) -> None:
    """T at the top of the volume is added, and all multiplied with the length of the ray in one slice.

    squared: (pixels,), (dx / dz)^2."""
    # T_{b-1} = E_b + T_b, and nothing lies beyond the last column: E becomes T.
    for b in range(len(sums) // LANES - 2, -1, -1):
        store(sums, b * LANES, plus(load(sums, b * LANES, LANES), load(sums, (b + 1) * LANES, LANES)))
    constant = (1.0 + tangent_y[first : first + count] ** 2).astype(np.float32)
    edge = np.float32(edge_z)
    for v in range(pixels):
        if last[v] >= 0:
            top = load(sums, (last[v] + 1) * LANES, LANES)
            store(image, v * LANES, plus(load(image, v * LANES, LANES), top))
        for lane in range(count):
            out[first + lane, v] = image[v * LANES + lane] * (edge * np.sqrt(constant[lane] + squared[v]))
    out[first : first + count, pixels:] = np.float32(0.0)
