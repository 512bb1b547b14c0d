"""Rasterising pieces into the output, one slab of rows at a time.

A thread writes only the slabs it is given, and within a slab pieces come in their own order: where two pieces claim a
voxel, the later one (interior) or the earlier one (skirt) wins for any number of threads.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.tissues import MAX_TISSUES
from simcore.warp.maps import TetMaps
from simcore.warp.pieces import Pieces

SLAB_ROWS = 8
EACH_BYTE = np.uint64(0x0101010101010101)
FLAT = 1e-11
"""A weight that changes less than this from voxel to voxel along x counts as constant along x."""


def rasterise(pieces: Pieces, maps: TetMaps, source: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Write the labels of all pieces into out, uint8 (nz, ny, nx); the number of air voxels that became tissue, for
    pieces with a face ``outside``.

    Pieces with a face ``outside`` write only where out is still air. Labels outside of ``source`` are air, but those
    below x = 0 are those of its first layer.
    """
    start, order = _slabs(pieces.bounds, -(-out.shape[1] // SLAB_ROWS))
    written = _rasterise(
        start, order, pieces.tet, pieces.slack, pieces.outside, pieces.bounds,
        maps.barycentric, maps.origin, source, out,
    )  # fmt: skip
    return int(written)


@numba.njit(cache=True)
def _slabs(bounds: NDArray[np.int64], slabs: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pieces of each slab of rows: order[start[s]:start[s + 1]], ascending."""
    start = np.zeros(slabs + 1, np.int64)
    for p in range(len(bounds)):
        if bounds[p, 0, 1] <= bounds[p, 1, 1]:
            for slab in range(bounds[p, 0, 1] // SLAB_ROWS, bounds[p, 1, 1] // SLAB_ROWS + 1):
                start[slab + 1] += 1
    start = np.cumsum(start)
    order = np.empty(start[-1], np.int64)
    position = start[:-1].copy()
    for p in range(len(bounds)):
        if bounds[p, 0, 1] <= bounds[p, 1, 1]:
            for slab in range(bounds[p, 0, 1] // SLAB_ROWS, bounds[p, 1, 1] // SLAB_ROWS + 1):
                order[position[slab]] = p
                position[slab] += 1
    return start, order


@numba.njit(parallel=True, cache=True, error_model="numpy")
def _rasterise(
    start: NDArray[np.int64],
    order: NDArray[np.int64],
    tet: NDArray[np.int64],
    slack: NDArray[np.float64],
    outside: NDArray[np.int64],
    bounds: NDArray[np.int64],
    barycentric: NDArray[np.float64],
    origin: NDArray[np.float64],
    source: NDArray[np.uint8],
    out: NDArray[np.uint8],
) -> int:
    slabs = len(start) - 1
    written = np.zeros(slabs, np.int64)
    # Slabs 0, 7, 14, .. come first: consecutive ones, which are all thick or all thin, go to different threads.
    stride = 7 if slabs % 7 else 5 if slabs % 5 else 1
    for task in numba.prange(slabs):
        slab = task * stride % slabs
        for entry in range(start[slab], start[slab + 1]):
            p = order[entry]
            j_first = max(bounds[p, 0, 1], slab * SLAB_ROWS)
            j_last = min(bounds[p, 1, 1], slab * SLAB_ROWS + SLAB_ROWS - 1)
            weight = barycentric[tet[p]]
            place = origin[tet[p]]
            for k in range(bounds[p, 0, 2], bounds[p, 1, 2] + 1):
                for j in range(j_first, j_last + 1):
                    low, high = _interval(weight, slack[p], outside[p], j, k, bounds[p, 0, 0], bounds[p, 1, 0])
                    if low <= high:
                        written[slab] += _fill(source, place, low, high, j, k, outside[p] >= 0, out)
    return int(written.sum())


@numba.njit(cache=True, error_model="numpy")
def _interval(
    weight: NDArray[np.float64], slack: NDArray[np.float64], outside: int, j: int, k: int, first: int, last: int
) -> tuple[int, int]:
    """First and last voxel i of row (j, k) in a piece; first > last: none."""
    low, high = float(first), float(last)
    for n in range(4):
        value = weight[n, 0] + weight[n, 2] * j + weight[n, 3] * k
        slope = weight[n, 1]
        if slope > FLAT:
            low = max(low, -(value + slack[n]) / slope)
        elif slope < -FLAT:
            high = min(high, -(value + slack[n]) / slope)
        elif value < -slack[n]:
            return 1, 0
        if n == outside:
            if slope > FLAT:
                high = min(high, -value / slope)
            elif slope < -FLAT:
                low = max(low, -value / slope)
            elif value > 0.0:
                return 1, 0
    if not low <= high:
        return 1, 0
    return math.ceil(low), math.floor(high)


@numba.njit(cache=True, error_model="numpy")
def _fill(
    source: NDArray[np.uint8],
    place: NDArray[np.float64],
    first: int,
    last: int,
    j: int,
    k: int,
    only_air: bool,
    out: NDArray[np.uint8],
) -> int:
    """Labels of the voxels first..last of row (j, k). With ``only_air``: the number that became tissue."""
    nz, ny, nx = source.shape
    x = place[0, 0] + place[0, 1] * first + place[0, 2] * j + place[0, 3] * k
    y = place[1, 0] + place[1, 1] * first + place[1, 2] * j + place[1, 3] * k
    z = place[2, 0] + place[2, 1] * first + place[2, 2] * j + place[2, 3] * k
    dx, dy, dz = place[0, 1], place[1, 1], place[2, 1]
    row = out[k, j]
    steps = last - first
    inside = _spans(x, steps * dx, nx) and _spans(y, steps * dy, ny) and _spans(z, steps * dz, nz)
    if inside and not only_air:
        for step in range(steps + 1):
            row[np.uint64(first + step)] = source[
                np.uint64(z + step * dz), np.uint64(y + step * dy), np.uint64(x + step * dx)
            ]
        return 0
    written = 0
    for step in range(steps + 1):
        i = first + step
        if only_air and row[i] != 0:
            continue
        at_x = max(math.floor(x + step * dx), 0)
        at_y = math.floor(y + step * dy)
        at_z = math.floor(z + step * dz)
        if at_x < nx and 0 <= at_y < ny and 0 <= at_z < nz:
            row[i] = source[at_z, at_y, at_x]
            written += only_air and row[i] != 0
        elif not only_air:
            row[i] = 0
    return written


@numba.njit(cache=True)
def _spans(start: float, change: float, size: int) -> bool:
    """True where start and start + change both lie in [0, size)."""
    return min(start, start + change) >= 0.0 and max(start, start + change) < size


def census(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Voxels of every label, int64 (MAX_TISSUES,)."""
    counts: NDArray[np.int64] = _census(labels).sum(axis=0)
    return counts


@numba.njit(parallel=True, cache=True)
def _census(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    nz, ny, nx = labels.shape
    counts = np.zeros((nz, MAX_TISSUES), np.int64)
    whole = nx - nx % 8
    for k in numba.prange(nz):
        table = np.zeros(256, np.int64)
        for j in range(ny):
            row = labels[k, j]
            # Neighbours are mostly alike: eight of them are one comparison.
            for n, word in enumerate(row[:whole].view(np.uint64)):
                if word == (word & np.uint64(255)) * EACH_BYTE:
                    table[word & np.uint64(255)] += 8
                else:
                    for i in range(8 * n, 8 * n + 8):
                        table[row[i]] += 1
            for i in range(whole, nx):
                table[row[i]] += 1
        counts[k] = table[:MAX_TISSUES]
    return counts


@numba.njit(parallel=True, cache=True)
def count_holes(labels: NDArray[np.uint8]) -> int:
    """Air voxels with tissue on all six sides."""
    nz, ny, nx = labels.shape
    found = np.zeros(nz, np.int64)
    whole = nx - nx % 8
    for k in numba.prange(1, nz - 1):
        for j in range(1, ny - 1):
            for n, word in enumerate(labels[k, j, :whole].view(np.uint64)):
                # All air, or no byte of it: most rows have nothing in between.
                if word != 0 and (word - EACH_BYTE) & ~word & (EACH_BYTE << np.uint64(7)):
                    found[k] += _holes(labels, k, j, max(8 * n, 1), min(8 * n + 8, nx - 1))
            found[k] += _holes(labels, k, j, max(whole, 1), nx - 1)
    return int(found.sum())


@numba.njit(cache=True)
def _holes(labels: NDArray[np.uint8], k: int, j: int, first: int, stop: int) -> int:
    """Holes of one voxel among the voxels first..stop - 1 of an inner row, none at its ends."""
    found = 0
    for i in range(first, stop):
        if labels[k, j, i] == 0:
            along_x = labels[k, j, i - 1] != 0 and labels[k, j, i + 1] != 0
            along_y = labels[k, j - 1, i] != 0 and labels[k, j + 1, i] != 0
            found += along_x and along_y and labels[k - 1, j, i] != 0 and labels[k + 1, j, i] != 0
    return found
