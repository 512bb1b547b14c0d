"""Exact line integrals (Siddon's) for a whole detector row at once.

The pixels of a detector row and the source lie in one plane, and that plane contains the x direction: along every ray
of the row, y is the same function of z. So for a row, let T_c(z) be the integral of mu from the bottom of the volume
to height z at the x column c, taken along that common path. A ray runs through few columns: it leaves column b for
column b - 1 at a height z_b that depends on the pixel alone, and its integral is

    sum over its columns of (T at leaving - T at entering) = T_last(top) - sum over b of E_b(z_b),   E_b = T_{b-1} - T_b

times the length of the ray per unit of height. T is a running sum over slices, vectorised along x; what is left for a
single ray is one term for each column boundary it crosses. The idea of sharing the prefix sums along one axis is that
of separable projectors; the lengths are Siddon's (Med. Phys. 12 (1985) 252-255) without approximation.

A detector that is moved or turned about the x axis is served too: each of its rows is replaced by the row of z = 0 that
the same rays meet, with its own pixel pitch. A stationary detector shares the table of crossings between all rows, and
``plane_prefix_lanes`` serves it three times as fast; paths so flat that they meet many voxel rows in a slice stay here.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES
from simcore.core.vectors import LANES
from simcore.projection import plane_prefix_lanes
from simcore.projection.borders import Borders
from simcore.projection.crossings import Columns, Crossings, crossings_of
from simcore.projection.schedule import spread

ROWS_PER_TILE = 48
COLUMNS_HELD = 64
"""Columns of a slice whose differences a tile keeps; more where one path meets more in a slice."""
SLICES_PER_BLOCK = 4
"""A row works through so many slices before the next row follows: its sums stay in the first-level cache."""
CODES_PER_GROUP = 4
FAST = {"contract", "nsz", "nnan", "ninf", "arcp"}


# Plain tuples, for numba cannot hand named ones to its threads.

Voxels = tuple[NDArray[np.uint8], NDArray[np.int32], NDArray[np.uint8], NDArray[np.float32]]
"""labels (nz, ny, nx); ends (nz, ny), see ``Borders.row_ends``; codes and values, see ``_codes``."""

Rows = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""What the rays of a detector row have in common, each (rows,): bottom_y and top_y, where they enter and leave the
volume's slices along y, in voxels; stretch, the pixel pitch on z = 0 relative to that on the detector; dy / dz."""


def serves(geometry: AcquisitionGeometry, view: int) -> bool:
    """True where columns run along x, and x falls from every pixel to the source: it is not beyond the chest-wall
    edge."""
    along_x = geometry.column_direction(view)[0] == 1.0
    edge = geometry.detector_frame(view)[0][0]
    return bool(along_x and geometry.sources[view, 0] < edge + geometry.detector.pixel / 2)


def serves_lanes(geometry: AcquisitionGeometry, view: int, grid: Grid) -> bool:
    """True where ``plane_prefix_lanes`` can do it: all rows share their crossings, and no path meets more than two
    voxel rows in a slice."""
    bottom_y, top_y, stretch, _ = tasks_of(geometry, view, grid)[0]
    flattest = np.abs(top_y - bottom_y).max() / grid.shape[0]
    return bool(np.all(stretch == stretch[0]) and flattest < plane_prefix_lanes.FLATTEST)


def project_planes(
    labels: NDArray[np.uint8],
    borders: Borders,
    grid: Grid,
    geometry: AcquisitionGeometry,
    view: int,
    mu: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Line integrals of one view.

    labels: uint8 (nz, ny, nx) on ``grid``, detector frame, below the source and above the detector.
    borders: of the labels.
    mu: (MAX_TISSUES,), 1/mm.
    out: float32 (detector.ny, detector.nx), overwritten; dimensionless, within 1e-5 of double precision.
    """
    rows, columns, tile_rows, order, source_z = tasks_of(geometry, view, grid)
    ends = borders.row_ends(np.abs(mu))
    if serves_lanes(geometry, view, grid):
        plane_prefix_lanes.project_lanes(
            (borders.start, borders.packed, borders.falls(mu), *borders.shape),
            rows,
            columns,
            spread(-(-len(rows[0]) // LANES)),
            int(ends.max()),
            source_z,
            grid.spacing[2],
            out,
        )
    else:
        _project((labels, ends, *_codes(mu)), rows, columns, tile_rows, order, source_z, grid.spacing[2], out)


def tasks_of(
    geometry: AcquisitionGeometry, view: int, grid: Grid
) -> tuple[Rows, Columns, int, NDArray[np.int64], float]:
    """What the rays of a view have in common: rows, columns, rows of a tile, order of the tiles, z of the source."""
    detector = geometry.detector
    source_x, source_y, source_z = geometry.sources[view]
    origin, row_direction = geometry.detector_frame(view)
    offsets = detector.y_centres()[:, None] * row_direction
    row_y, row_z = origin[1] + offsets[:, 1], origin[2] + offsets[:, 2]
    stretch = source_z / (source_z - row_z)
    # Along a ray, a coordinate at height z is source + (its value at z = 0 - source) (source_z - z) / source_z.
    share_bottom = (source_z - grid.corner[2]) / source_z
    share_top = (source_z - grid.upper[2]) / source_z
    virtual_y = (row_y - source_y) * stretch
    bottom_y = (source_y - grid.corner[1] + virtual_y * share_bottom) / grid.spacing[1]
    top_y = (source_y - grid.corner[1] + virtual_y * share_top) / grid.spacing[1]
    rows = (bottom_y, top_y, stretch, virtual_y / source_z)
    source_cell = (source_x - grid.corner[0]) / grid.spacing[0]
    pixel_x = origin[0] + detector.x_centres() - source_x
    columns = (pixel_x, grid.spacing[0], source_cell, share_bottom, grid.spacing[2] / source_z)
    tile_rows = ROWS_PER_TILE if np.all(stretch == stretch[0]) else 1
    order = spread(-(-detector.ny // tile_rows))
    return rows, columns, tile_rows, order, source_z


def _codes(mu: NDArray[np.float64]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """The labels with mu > 0 and their mu, in groups of CODES_PER_GROUP; filled up with pairs that add nothing."""
    used = np.flatnonzero(mu)
    padded = -(-len(used) // CODES_PER_GROUP) * CODES_PER_GROUP
    codes = np.full(padded, MAX_TISSUES, np.uint8)
    values = np.zeros(padded, np.float32)
    codes[: len(used)], values[: len(used)] = used, mu[used]
    return codes.reshape(-1, CODES_PER_GROUP), values.reshape(-1, CODES_PER_GROUP)


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _project(
    voxels: Voxels,
    rows: Rows,
    columns: Columns,
    tile_rows: int,
    order: NDArray[np.int64],
    source_z: float,
    edge_z: float,
    out: NDArray[np.float32],
) -> None:
    """Tiles of ``tile_rows`` rows share a table of crossings and the conversion of labels; 1: each row has its own."""
    labels, ends, _, _ = voxels
    stretch = rows[2]
    tangent_x = columns[0] / source_z
    squared = (tangent_x * tangent_x).astype(np.float32)
    shared = crossings_of(columns, stretch[0], labels.shape[0], ends.max() if tile_rows > 1 else -1)
    for task in numba.prange(len(order)):
        first_row = order[task] * tile_rows
        last_row = min(first_row + tile_rows, len(stretch))
        out[first_row:last_row] = np.float32(0.0)
        reach = reach_of(ends, rows, first_row, last_row)
        if reach > 0:
            prefix = aligned_zeros(last_row - first_row, reach + 1)
            if tile_rows > 1:
                _run_tile(voxels, rows, shared, first_row, last_row, prefix, out)
                _finish(prefix, rows, shared, squared, edge_z, first_row, out)
            else:
                own = crossings_of(columns, stretch[first_row], labels.shape[0], reach)
                _run_tile(voxels, rows, own, first_row, last_row, prefix, out)
                _finish(prefix, rows, own, squared, edge_z, first_row, out)


@numba.njit(cache=True)
def aligned_zeros(rows: int, columns: int) -> NDArray[np.float32]:
    """float32 (rows, columns or a few more), each row from a cache line on: no vector of 16 lies across two."""
    width = -(-columns // 16) * 16
    memory = np.zeros(rows * width + 16, np.float32)
    shift = (-memory.ctypes.data % 64) // 4
    return memory[shift : shift + rows * width].reshape(rows, width)


@numba.njit(cache=True)
def reach_of(ends: NDArray[np.int32], rows: Rows, first: int, last: int) -> int:
    """Largest x end of the voxel rows that these detector rows can meet."""
    bottom_y, top_y, _, _ = rows
    nz, ny = ends.shape
    low = min(min(bottom_y[first], bottom_y[last - 1]), min(top_y[first], top_y[last - 1]))
    high = max(max(bottom_y[first], bottom_y[last - 1]), max(top_y[first], top_y[last - 1]))
    reach = 0
    for k in range(nz):
        for j in range(max(0, math.floor(low)), min(ny, math.floor(high) + 1)):
            reach = max(reach, ends[k, j])
    return reach


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _run_tile(
    voxels: Voxels,
    rows: Rows,
    crossings: Crossings,
    first_row: int,
    last_row: int,
    prefix: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Subtract E_b(z_b) of every crossing from out; leave E at the top of the volume in ``prefix``.

    Where a row's path stays in one column through a slice, E grows linearly in it; where it turns from one column to
    the next, E has a bend. A path so flat that it meets more columns takes them one by one."""
    # Tuples are taken apart here, once: every taking apart counts references, which costs as much as a crossing.
    labels, ends, codes, values = voxels
    start, pixel, boundary, fraction, _ = crossings
    bottom_y, top_y, _, _ = rows
    width = prefix.shape[1]
    slices = labels.shape[0]
    flattest = np.abs(top_y[first_row:last_row] - bottom_y[first_row:last_row]).max() / slices
    columns_held = max(COLUMNS_HELD, int(flattest) + 2)
    slots = SLICES_PER_BLOCK * columns_held
    memory = aligned_zeros(slots + 1, width)  # the last slot: beside the volume
    held = np.empty(slots + 1, np.int64)
    scratch = np.zeros(width + 1, np.float32)
    known = np.zeros(last_row - first_row, np.int64)
    for block in range(0, slices, SLICES_PER_BLOCK):
        held[:] = -1
        for row in range(first_row, last_row):
            sums, sink = prefix[row - first_row], out[row]
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
                            _differences(labels[k, c], ends[k, c] + 1, codes, values, scratch, memory[slot])
                            held[slot] = c
                if end == 0:
                    continue
                first, stop = start[k], start[k + 1]
                entered = memory[slot_of(ends, columns_held, k, column)]
                step = 1 if final > column else -1
                turn = np.float32((column + (step > 0) - enter_y) / slope)
                if final == column:
                    _cross(sums, entered, first, stop, pixel, boundary, fraction, end, sink)
                    add(sums, entered, end, np.float32(1.0))
                elif final == column + step:
                    left = memory[slot_of(ends, columns_held, k, final)]
                    _cross_turning(sums, entered, left, turn, first, stop, pixel, boundary, fraction, end, sink)
                    add_turning(sums, entered, left, end, turn)
                else:
                    _cross_nothing(sums, first, stop, pixel, boundary, end, sink)
                    low = np.float32(0.0)
                    for c in range(column, final + step, step):
                        high = np.float32((c + (step > 0) - enter_y) / slope) if c != final else np.float32(1.0)
                        passed = memory[slot_of(ends, columns_held, k, c)]
                        _cross_part(passed, low, high, first, stop, pixel, boundary, fraction, end, sink)
                        add(sums, passed, end, high - low)
                        low = high
            known[row - first_row] = end


@numba.njit(cache=True)
def slot_of(ends: NDArray[np.int32], columns_held: int, k: int, column: int) -> int:
    """Where the differences of a column are kept; the last slot for columns without tissue."""
    if column < 0 or column >= ends.shape[1] or ends[k, column] == 0:
        return SLICES_PER_BLOCK * columns_held
    return (k % SLICES_PER_BLOCK) * columns_held + column % columns_held


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _differences(
    labels: NDArray[np.uint8],
    end: int,
    codes: NDArray[np.uint8],
    values: NDArray[np.float32],
    scratch: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """out[b] = mu of voxel b - 1 minus mu of voxel b, b = 0..end - 1; 0 beyond.

    A chain of selects instead of a table: it vectorises."""
    zero = np.float32(0.0)
    for group in range(codes.shape[0]):
        c0, c1, c2, c3 = codes[group, 0], codes[group, 1], codes[group, 2], codes[group, 3]
        m0, m1, m2, m3 = values[group, 0], values[group, 1], values[group, 2], values[group, 3]
        for i in range(end - 1):
            label = labels[i]
            m = zero if group == 0 else scratch[i + 1]
            m = m0 if label == c0 else m
            m = m1 if label == c1 else m
            m = m2 if label == c2 else m
            m = m3 if label == c3 else m
            scratch[i + 1] = m
    scratch[0] = zero
    scratch[end] = zero
    for b in range(end):
        out[b] = scratch[b] - scratch[b + 1]
    out[end:] = zero


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def add(prefix: NDArray[np.float32], step: NDArray[np.float32], end: int, part: np.float32) -> None:
    for b in range(end):
        prefix[b] += part * step[b]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def add_turning(
    prefix: NDArray[np.float32], entered: NDArray[np.float32], left: NDArray[np.float32], end: int, turn: np.float32
) -> None:
    rest = np.float32(1.0) - turn
    for b in range(end):
        prefix[b] += turn * entered[b] + rest * left[b]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross(
    prefix: NDArray[np.float32],
    step: NDArray[np.float32],
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    fraction: NDArray[np.float32],
    end: int,
    out: NDArray[np.float32],
) -> None:
    for event in range(np.uint64(first), np.uint64(stop)):
        b = boundary[event]
        if b >= end:
            break
        out[pixel[event]] -= prefix[b] + fraction[event] * step[b]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross_turning(
    prefix: NDArray[np.float32],
    entered: NDArray[np.float32],
    left: NDArray[np.float32],
    turn: np.float32,
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    fraction: NDArray[np.float32],
    end: int,
    out: NDArray[np.float32],
) -> None:
    """As ``_cross``, where the path leaves one column for the next at the height ``turn`` within the slice."""
    for event in range(np.uint64(first), np.uint64(stop)):
        b = boundary[event]
        if b >= end:
            break
        before = min(fraction[event], turn)
        out[pixel[event]] -= prefix[b] + before * entered[b] + (fraction[event] - before) * left[b]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross_nothing(
    prefix: NDArray[np.float32],
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    end: int,
    out: NDArray[np.float32],
) -> None:
    for event in range(np.uint64(first), np.uint64(stop)):
        b = boundary[event]
        if b >= end:
            break
        out[pixel[event]] -= prefix[b]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _cross_part(
    step: NDArray[np.float32],
    low: np.float32,
    high: np.float32,
    first: int,
    stop: int,
    pixel: NDArray[np.uint32],
    boundary: NDArray[np.uint32],
    fraction: NDArray[np.float32],
    end: int,
    out: NDArray[np.float32],
) -> None:
    """The share of one column, between two heights within the slice."""
    for event in range(np.uint64(first), np.uint64(stop)):
        b = boundary[event]
        if b >= end:
            break
        out[pixel[event]] -= (min(max(fraction[event], low), high) - low) * step[b]


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _finish(
    prefix: NDArray[np.float32],
    rows: Rows,
    crossings: Crossings,
    squared: NDArray[np.float32],
    edge_z: float,
    first_row: int,
    out: NDArray[np.float32],
) -> None:
    """Add T at the top of the volume and multiply with the length of the ray in one slice.

    squared: (pixels,), (dx / dz)^2 for a stretch of 1."""
    _, _, stretch, tangent_y = rows
    last = crossings[4]
    reach = prefix.shape[1] - 1
    top = np.empty(reach + 1, np.float32)
    for local in range(prefix.shape[0]):
        row = first_row + local
        # T_{b-1} = E_b + T_b, and nothing lies beyond the last column.
        total = np.float32(0.0)
        for b in range(reach, -1, -1):
            total += prefix[local, b]
            top[b] = total
        # Columns at the top ascend with the pixel: from here on the rays pass beyond the tissue.
        pixels = np.searchsorted(last, reach)
        for v in range(pixels):
            if last[v] >= 0:
                out[row, v] += top[last[v] + 1]
        constant = np.float32(1.0 + tangent_y[row] ** 2)
        factor = np.float32(stretch[row] ** 2)
        edge = np.float32(edge_z)
        for v in range(pixels):
            out[row, v] *= edge * math.sqrt(constant + factor * squared[v])
