"""Plane prefixes (see ``plane_prefix``) of one detector row after the other, for several maps at a time.

Attenuation at any energy is a sum of a few functions of energy times numbers of the material (its basis coefficients);
the path integrals of these numbers, a map each, give the attenuation of a whole spectrum. Borders, the voxel rows that
a path meets and the crossings are the same for all maps. Their sums lie side by side, MAPS numbers to a column boundary
or pixel, so that a border or a crossing is one short vector.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange
from simcore.projection.borders import PLACE_SHIFT
from simcore.projection.crossings import Columns, Crossings, crossings_of
from simcore.simd.aligned import zeros
from simcore.simd.vector import fma, load, minus, plus, splat, store, times

MAPS = 4
"""Side by side; a pass with fewer carries zeros along."""
FAST = {"contract", "nsz", "nnan", "ninf", "arcp"}

FloatArray = NDArray[np.float32]

# Plain tuples, for numba cannot hand named ones to its threads.

Rows = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""What the rays of a detector row have in common, each (rows,): bottom_y and top_y, where they enter and leave the
volume's slices along y, in voxels; stretch, the pixel pitch on z = 0 relative to that on the detector; dy / dz."""

Tissue = tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.int32], FloatArray]
"""start and packed of ``Borders``; ends (nz, ny), see ``Borders.row_ends``; MAPS falls of each border, see
``falls_of``."""


def falls_of(basis: NDArray[np.float64]) -> FloatArray:
    """By how much each map falls at a border, by the lower eight bits of its number, (256 * MAPS,).

    basis: (maps, MAX_TISSUES), at most MAPS maps."""
    values = basis.astype(np.float32)
    falls = np.zeros((values.shape[1] ** 2, MAPS), np.float32)
    falls[:, : len(values)] = (values[:, :, None] - values[:, None, :]).reshape(len(values), -1).T
    return falls.ravel()


@njit(parallel=True, cache=True, error_model="numpy")
def project_rows(
    tissue: Tissue,
    rows: Rows,
    columns: Columns,
    alike: bool,
    order: NDArray[np.int64],
    source_z: float,
    edge_z: float,
    out: FloatArray,
) -> None:
    """Line integrals of every map for one view.

    alike: all rows have one stretch, and so the same crossings. order: of the rows.
    out: float32 (maps, rows, pixels), overwritten.
    """
    ends = tissue[2]
    slices = ends.shape[0]
    stretch = rows[2]
    tangent_x = columns[0] / source_z
    squared = (tangent_x * tangent_x).astype(np.float32)
    shared = crossings_of(columns, stretch[0], slices, ends.max() if alike else -1)
    for task in prange(len(order)):
        row = order[task]
        out[:, row] = np.float32(0.0)
        reach = _reach_of(ends, rows[0][row], rows[1][row])
        if reach > 0:
            crossings = shared if alike else crossings_of(columns, stretch[row], slices, reach)
            sums = zeros((reach + 1) * MAPS)
            image = zeros(out.shape[2] * MAPS)
            _run_row(tissue, rows[0][row], rows[1][row], crossings, sums, image)
            _finish(sums, rows[2][row], rows[3][row], crossings[4], squared, edge_z, image, out[:, row])


@njit(cache=True)
def _reach_of(ends: NDArray[np.int32], bottom_y: float, top_y: float) -> int:
    """Largest x end of the voxel rows that a detector row can meet."""
    low, high = min(bottom_y, top_y), max(bottom_y, top_y)
    reach = 0
    for k in range(ends.shape[0]):
        for j in range(max(0, math.floor(low)), min(ends.shape[1], math.floor(high) + 1)):
            reach = max(reach, ends[k, j])
    return reach


@njit(cache=True, error_model="numpy")
def _run_row(
    tissue: Tissue, bottom_y: float, top_y: float, crossings: Crossings, sums: FloatArray, image: FloatArray
) -> None:
    """Subtracts E_b(z_b) of every crossing from ``image``; leaves E at the top of the volume in ``sums``.

    Where the path stays in one voxel row through a slice, E grows linearly in it; where it turns from one to the next,
    E has a bend. A path so flat that it meets more voxel rows takes them one by one."""
    # Tuples are taken apart here, once: every taking apart counts references.
    start, packed, ends, falls = tissue
    event_start, pixel, boundary, fraction, _ = crossings
    slices, depth = ends.shape
    slope = (top_y - bottom_y) / slices
    entered, left = zeros(len(sums)), zeros(len(sums))
    end = 0
    for k in range(slices):
        enter_y = bottom_y + slope * k
        column, final = math.floor(enter_y), math.floor(bottom_y + slope * (k + 1))
        for c in range(max(min(column, final), 0), min(max(column, final), depth - 1) + 1):
            if ends[k, c] > 0:
                end = max(end, ends[k, c] + 1)
        if end == 0:
            continue
        events = range(np.uint64(event_start[k]), np.uint64(event_start[k + 1]))
        step = 1 if final > column else -1
        turn = np.float32((column + (step > 0) - enter_y) / slope)
        here = _borders_of(start, packed, ends, k, column)
        there = _borders_of(start, packed, ends, k, final)
        if final == column:
            _put(entered, here, packed, falls)
            for event in events:
                if boundary[event] >= end:
                    break
                b, v = np.int64(boundary[event]) * MAPS, np.int64(pixel[event]) * MAPS
                total = fma(splat(fraction[event], MAPS), load(entered, b, MAPS), load(sums, b, MAPS))
                store(image, v, minus(load(image, v, MAPS), total))
            _grow(sums, entered, here, packed, np.float32(1.0))
        elif final == column + step:
            _put(entered, here, packed, falls)
            _put(left, there, packed, falls)
            for event in events:
                if boundary[event] >= end:
                    break
                b, v = np.int64(boundary[event]) * MAPS, np.int64(pixel[event]) * MAPS
                before = min(fraction[event], turn)
                total = fma(splat(before, MAPS), load(entered, b, MAPS), load(sums, b, MAPS))
                total = fma(splat(fraction[event] - before, MAPS), load(left, b, MAPS), total)
                store(image, v, minus(load(image, v, MAPS), total))
            _grow_turning(sums, entered, left, here, packed, turn)
            _grow_turning(sums, entered, left, there, packed, turn)
        else:
            for event in events:
                if boundary[event] >= end:
                    break
                b, v = np.int64(boundary[event]) * MAPS, np.int64(pixel[event]) * MAPS
                store(image, v, minus(load(image, v, MAPS), load(sums, b, MAPS)))
            low = np.float32(0.0)
            for c in range(column, final + step, step):
                high = np.float32((c + (step > 0) - enter_y) / slope) if c != final else np.float32(1.0)
                passed = _borders_of(start, packed, ends, k, c)
                _put(entered, passed, packed, falls)
                for event in events:
                    if boundary[event] >= end:
                        break
                    b, v = np.int64(boundary[event]) * MAPS, np.int64(pixel[event]) * MAPS
                    part = splat(low - min(max(fraction[event], low), high), MAPS)
                    store(image, v, fma(part, load(entered, b, MAPS), load(image, v, MAPS)))
                _grow(sums, entered, passed, packed, high - low)
                low = high


@njit(cache=True)
def _borders_of(
    start: NDArray[np.int64], packed: NDArray[np.uint32], ends: NDArray[np.int32], k: int, column: int
) -> tuple[int, int]:
    """The first border of a voxel row, and one more than the last that any map knows; none beside the volume."""
    if column < 0 or column >= ends.shape[1]:
        return 0, 0
    row = k * ends.shape[1] + column
    first, stop = start[row], start[row + 1]
    while stop > first and packed[stop - 1] >> np.uint32(PLACE_SHIFT) > ends[k, column]:
        stop -= 1
    return first, stop


@njit(cache=True)
def _put(step: FloatArray, borders: tuple[int, int], packed: NDArray[np.uint32], falls: FloatArray) -> None:
    """By how much E grows in a whole slice."""
    for border in range(np.uint64(borders[0]), np.uint64(borders[1])):
        b = np.int64(packed[border] >> np.uint32(PLACE_SHIFT)) * MAPS
        store(step, b, load(falls, np.int64(packed[border] & np.uint32(255)) * MAPS, MAPS))


@njit(cache=True)
def _grow(
    sums: FloatArray, step: FloatArray, borders: tuple[int, int], packed: NDArray[np.uint32], part: np.float32
) -> None:
    """sums += part step, and step = 0, at these borders."""
    for border in range(np.uint64(borders[0]), np.uint64(borders[1])):
        b = np.int64(packed[border] >> np.uint32(PLACE_SHIFT)) * MAPS
        store(sums, b, fma(splat(part, MAPS), load(step, b, MAPS), load(sums, b, MAPS)))
        store(step, b, splat(np.float32(0.0), MAPS))


@njit(cache=True)
def _grow_turning(
    sums: FloatArray,
    entered: FloatArray,
    left: FloatArray,
    borders: tuple[int, int],
    packed: NDArray[np.uint32],
    turn: np.float32,
) -> None:
    """sums += turn entered + (1 - turn) left, and both 0, at these borders."""
    for border in range(np.uint64(borders[0]), np.uint64(borders[1])):
        b = np.int64(packed[border] >> np.uint32(PLACE_SHIFT)) * MAPS
        grown = times(splat(np.float32(1.0) - turn, MAPS), load(left, b, MAPS))
        grown = fma(splat(turn, MAPS), load(entered, b, MAPS), grown)
        store(sums, b, plus(load(sums, b, MAPS), grown))
        store(entered, b, splat(np.float32(0.0), MAPS))
        store(left, b, splat(np.float32(0.0), MAPS))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _finish(
    sums: FloatArray,
    stretch: float,
    tangent_y: float,
    last: NDArray[np.int32],
    squared: FloatArray,
    edge_z: float,
    image: FloatArray,
    out: FloatArray,
) -> None:
    """T at the top of the volume is added, all is multiplied with the length of the ray in one slice, the maps part.

    squared: (pixels,), (dx / dz)^2 for a stretch of 1. out: (maps, pixels)."""
    reach = len(sums) // MAPS - 1
    # T_{b-1} = E_b + T_b, and nothing lies beyond the last column: E becomes T.
    for b in range(reach - 1, -1, -1):
        store(sums, b * MAPS, plus(load(sums, b * MAPS, MAPS), load(sums, (b + 1) * MAPS, MAPS)))
    # Columns at the top ascend with the pixel: from here on the rays pass beyond the tissue.
    pixels = np.searchsorted(last, reach)
    constant, factor, edge = np.float32(1.0 + tangent_y**2), np.float32(stretch**2), np.float32(edge_z)
    for v in range(pixels):
        if last[v] >= 0:
            store(image, v * MAPS, plus(load(image, v * MAPS, MAPS), load(sums, (last[v] + 1) * MAPS, MAPS)))
    for m in range(out.shape[0]):
        for v in range(pixels):
            out[m, v] = image[v * MAPS + m] * (edge * math.sqrt(constant + factor * squared[v]))
