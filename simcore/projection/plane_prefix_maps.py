"""Plane prefix (see ``plane_prefix``) for several basis maps in one pass over the labels.

Attenuation at any energy is a sum of a few functions of energy times numbers of the material (its basis coefficients);
the path integrals of these numbers, a map each, give the attenuation of a whole spectrum. Labels, the columns that a
row's path meets and the crossings are the same for all maps. Their sums lie side by side, MAPS numbers to a column
boundary or pixel, so that a crossing reads and writes one short run of memory for all of them (``quads``).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES
from simcore.projection.crossings import Columns, Crossings, crossings_of
from simcore.projection.plane_prefix import (
    COLUMNS_HELD,
    FAST,
    SLICES_PER_BLOCK,
    Rows,
    add,
    add_turning,
    aligned_zeros,
    reach_of,
    slot_of,
    tasks_of,
)
from simcore.projection.quads import put_difference, take_one, take_two

MAPS = 4
"""Side by side; a pass with fewer carries zeros along."""

FloatArray = NDArray[np.float32]
Labels = tuple[NDArray[np.uint8], NDArray[np.int32], FloatArray]
"""labels (nz, ny, nx); ends (nz, ny), see ``Borders.row_ends``; table of MAPS numbers for each label and for none."""


def project_maps(
    labels: NDArray[np.uint8],
    ends: NDArray[np.int32],
    grid: Grid,
    geometry: AcquisitionGeometry,
    view: int,
    basis: NDArray[np.float64],
    out: FloatArray,
) -> None:
    """Line integrals of every map for one view.

    labels, ends, grid: as of ``plane_prefix.project_planes``; ends for all labels that any map knows.
    basis: (maps, MAX_TISSUES), at most MAPS maps; per mm.
    out: float32 (maps, detector.ny, detector.nx), overwritten; as exact as one map alone.
    """
    table = np.zeros((MAX_TISSUES + 1, MAPS), np.float32)
    table[:MAX_TISSUES, : len(basis)] = basis.T
    rows, columns, tile_rows, order, source_z = tasks_of(geometry, view, grid)
    _project((labels, ends, table.ravel()), rows, columns, tile_rows, order, source_z, grid.spacing[2], out)


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _project(
    voxels: Labels,
    rows: Rows,
    columns: Columns,
    tile_rows: int,
    order: NDArray[np.int64],
    source_z: float,
    edge_z: float,
    out: FloatArray,
) -> None:
    labels, ends, _ = voxels
    stretch = rows[2]
    tangent_x = columns[0] / source_z
    squared = (tangent_x * tangent_x).astype(np.float32)
    shared = crossings_of(columns, stretch[0], labels.shape[0], ends.max() if tile_rows > 1 else -1)
    for task in numba.prange(len(order)):
        first_row = order[task] * tile_rows
        last_row = min(first_row + tile_rows, len(stretch))
        out[:, first_row:last_row] = np.float32(0.0)
        reach = reach_of(ends, rows, first_row, last_row)
        if reach > 0:
            prefix = aligned_zeros(last_row - first_row, (reach + 1) * MAPS)
            sums = np.zeros((last_row - first_row, out.shape[2] * MAPS), np.float32)
            if tile_rows > 1:
                _run_tile(voxels, rows, shared, first_row, last_row, prefix, sums)
                _finish(prefix, reach, rows, shared, squared, edge_z, first_row, sums, out)
            else:
                own = crossings_of(columns, stretch[first_row], labels.shape[0], reach)
                _run_tile(voxels, rows, own, first_row, last_row, prefix, sums)
                _finish(prefix, reach, rows, own, squared, edge_z, first_row, sums, out)


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _run_tile(
    voxels: Labels,
    rows: Rows,
    crossings: Crossings,
    first_row: int,
    last_row: int,
    prefix: FloatArray,
    sinks: FloatArray,
) -> None:
    """As ``plane_prefix._run_tile``."""
    labels, ends, table = voxels
    start, pixel, boundary, fraction, _ = crossings
    bottom_y, top_y, _, _ = rows
    width = prefix.shape[1]
    slices = labels.shape[0]
    flattest = np.abs(top_y[first_row:last_row] - bottom_y[first_row:last_row]).max() / slices
    columns_held = max(COLUMNS_HELD, int(flattest) + 2)
    slots = SLICES_PER_BLOCK * columns_held
    memory = aligned_zeros(slots + 1, width)
    held = np.empty(slots + 1, np.int64)
    known = np.zeros(last_row - first_row, np.int64)
    for block in range(0, slices, SLICES_PER_BLOCK):
        held[:] = -1
        for row in range(first_row, last_row):
            sums, sink = prefix[row - first_row], sinks[row - first_row]
            end = known[row - first_row]
            slope = (top_y[row] - bottom_y[row]) / slices
            for k in range(block, min(block + SLICES_PER_BLOCK, slices)):
                enter_y = bottom_y[row] + slope * k
                column, final = math.floor(enter_y), math.floor(bottom_y[row] + slope * (k + 1))
                for c in range(min(column, final), max(column, final) + 1):
                    slot = slot_of(ends, columns_held, k, c)
                    if slot < slots:
                        end = max(end, ends[k, c] + 1)
                        if held[slot] != c:
                            _differences(labels[k, c], ends[k, c] + 1, table, memory[slot])
                            held[slot] = c
                if end == 0:
                    continue
                first, stop = start[k], start[k + 1]
                entered = memory[slot_of(ends, columns_held, k, column)]
                step = 1 if final > column else -1
                turn = np.float32((column + (step > 0) - enter_y) / slope)
                if final == column:
                    _cross(sums, entered, first, stop, pixel, boundary, fraction, end, sink)
                    add(sums, entered, end * MAPS, np.float32(1.0))
                elif final == column + step:
                    left = memory[slot_of(ends, columns_held, k, final)]
                    _cross_turning(sums, entered, left, turn, first, stop, pixel, boundary, fraction, end, sink)
                    add_turning(sums, entered, left, end * MAPS, turn)
                else:
                    _cross(sums, memory[slots], first, stop, pixel, boundary, fraction, end, sink)
                    low = np.float32(0.0)
                    for c in range(column, final + step, step):
                        high = np.float32((c + (step > 0) - enter_y) / slope) if c != final else np.float32(1.0)
                        passed = memory[slot_of(ends, columns_held, k, c)]
                        _cross_part(passed, low, high, first, stop, pixel, boundary, fraction, end, sink)
                        add(sums, passed, end * MAPS, high - low)
                        low = high
            known[row - first_row] = end


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _differences(labels: NDArray[np.uint8], end: int, table: FloatArray, out: FloatArray) -> None:
    """As ``plane_prefix._differences``, MAPS numbers to a boundary."""
    before = np.int64(MAX_TISSUES) * MAPS  # nothing before the first voxel and behind the last
    for b in range(end - 1):
        after = np.int64(labels[b]) * MAPS
        put_difference(out, b * MAPS, table, before, after)
        before = after
    put_difference(out, (end - 1) * MAPS, table, before, np.int64(MAX_TISSUES) * MAPS)
    out[end * MAPS :] = np.float32(0.0)


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross(
    prefix: FloatArray,
    step: FloatArray,
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    fraction: FloatArray,
    end: int,
    out: FloatArray,
) -> None:
    for event in range(np.uint64(first), np.uint64(stop)):
        if boundary[event] >= end:
            break
        take_one(out, np.int64(pixel[event]) * MAPS, prefix, step, fraction[event], np.int64(boundary[event]) * MAPS)


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross_turning(
    prefix: FloatArray,
    entered: FloatArray,
    left: FloatArray,
    turn: np.float32,
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    fraction: FloatArray,
    end: int,
    out: FloatArray,
) -> None:
    for event in range(np.uint64(first), np.uint64(stop)):
        if boundary[event] >= end:
            break
        b, v = np.int64(boundary[event]) * MAPS, np.int64(pixel[event]) * MAPS
        before = min(fraction[event], turn)
        take_two(out, v, prefix, entered, before, left, fraction[event] - before, b)


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross_part(
    step: FloatArray,
    low: np.float32,
    high: np.float32,
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    fraction: FloatArray,
    end: int,
    out: FloatArray,
) -> None:
    for event in range(np.uint64(first), np.uint64(stop)):
        if boundary[event] >= end:
            break
        part = min(max(fraction[event], low), high) - low
        b, v = np.int64(boundary[event]) * MAPS, np.int64(pixel[event]) * MAPS
        for m in range(MAPS):
            out[v + m] -= part * step[b + m]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _finish(
    prefix: FloatArray,
    reach: int,
    rows: Rows,
    crossings: Crossings,
    squared: FloatArray,
    edge_z: float,
    first_row: int,
    sums: FloatArray,
    out: FloatArray,
) -> None:
    """As ``plane_prefix._finish``; the maps part here."""
    _, _, stretch, tangent_y = rows
    last = crossings[4]
    top = np.zeros((reach + 2, MAPS), np.float32)
    pixels = np.searchsorted(last, reach)
    for local in range(prefix.shape[0]):
        row = first_row + local
        for b in range(reach, -1, -1):
            for m in range(MAPS):
                top[b, m] = top[b + 1, m] + prefix[local, b * MAPS + m]
        constant = np.float32(1.0 + tangent_y[row] ** 2)
        factor = np.float32(stretch[row] ** 2)
        edge = np.float32(edge_z)
        for m in range(out.shape[0]):
            for v in range(pixels):
                total = sums[local, v * MAPS + m]
                if last[v] >= 0:
                    total += top[last[v] + 1, m]
                out[m, row, v] = total * edge * math.sqrt(constant + factor * squared[v])
