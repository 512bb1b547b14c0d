"""Rasterising pieces into the output, one slab of rows at a time.

A thread writes only the slabs it is given, and within a slab pieces come in their own order: where two pieces claim a
voxel, the later one (interior) or the earlier one (skirt) wins for any number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.core.tissues import MAX_TISSUES
from simcore.kernels import njit, prange
from simcore.simd.vector import word_at
from simcore.warp.maps import TetMaps
from simcore.warp.pieces import Pieces

SLAB_ROWS = 16
EACH_BYTE = np.uint64(0x0101010101010101)
FLAT = 1e-11
"""A weight that changes less than this from voxel to voxel along x counts as constant along x."""
BITS = 32
UNIT = float(1 << BITS)
"""Places in the source are followed as integers of 1 / UNIT of a voxel: off by less than a millionth after a row."""
ROUNDING = 1e-6


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


@njit(cache=True)
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


@njit(parallel=True, cache=True, error_model="numpy")
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
    for task in prange(slabs):
        slab = task * stride % slabs
        planes = np.empty((3, 5, 3))
        box = np.empty((2, 3), np.int64)
        for entry in range(start[slab], start[slab + 1]):
            p = order[entry]
            for axis in range(3):
                box[0, axis], box[1, axis] = bounds[p, 0, axis], bounds[p, 1, axis]
            box[0, 1] = max(box[0, 1], slab * SLAB_ROWS)
            box[1, 1] = min(box[1, 1], slab * SLAB_ROWS + SLAB_ROWS - 1)
            counts = _planes(barycentric[tet[p]], slack[p], outside[p], planes)
            written[slab] += _piece(source, origin[tet[p]], planes, counts, box, outside[p] >= 0, out)
    return int(written.sum())


@njit(cache=True, error_model="numpy")
def _planes(
    weight: NDArray[np.float64], slack: NDArray[np.float64], outside: int, planes: NDArray[np.float64]
) -> tuple[int, int, int]:
    """What bounds a piece, as functions f = f[0] + f[1] j + f[2] k of a row: planes[0] the x it begins at, at the
    least; planes[1] the x it ends at, at the most; planes[2] what must not be negative. How many there are of each."""
    counts = [0, 0, 0]
    for n in range(4):
        slope = weight[n, 1]
        for beyond in range(2 if n == outside else 1):
            value = weight[n, 0] if beyond else weight[n, 0] + slack[n]
            if abs(slope) > FLAT:
                kind = int((slope < 0) != (beyond == 1))
                factor = -1.0 / slope
            else:
                kind = 2
                factor = -1.0 if beyond else 1.0
            bound = planes[kind, counts[kind]]
            bound[0], bound[1], bound[2] = value * factor, weight[n, 2] * factor, weight[n, 3] * factor
            counts[kind] += 1
    return counts[0], counts[1], counts[2]


@njit(cache=True, error_model="numpy")
def _piece(
    source: NDArray[np.uint8],
    place: NDArray[np.float64],
    planes: NDArray[np.float64],
    counts: tuple[int, int, int],
    box: NDArray[np.int64],
    only_air: bool,
    out: NDArray[np.uint8],
) -> int:
    """Labels of the voxels of a piece in a box. With ``only_air``: the number that became tissue.

    Rows are short, nine voxels as a rule: whatever a row needs is a number here, for a view of an array counts
    references, which takes as long as the row."""
    nz, ny, nx = source.shape
    begins, ends, signs = counts
    x0, xi, xj, xk = place[0, 0], place[0, 1], place[0, 2], place[0, 3]
    y0, yi, yj, yk = place[1, 0], place[1, 1], place[1, 2], place[1, 3]
    z0, zi, zj, zk = place[2, 0], place[2, 1], place[2, 2], place[2, 3]
    step_x, step_y, step_z = np.int64(xi * UNIT), np.int64(yi * UNIT), np.int64(zi * UNIT)
    written = 0
    for k in range(box[0, 2], box[1, 2] + 1):
        for j in range(box[0, 1], box[1, 1] + 1):
            low, high = float(box[0, 0]), float(box[1, 0])
            for n in range(begins):
                low = max(low, planes[0, n, 0] + planes[0, n, 1] * j + planes[0, n, 2] * k)
            for n in range(ends):
                high = min(high, planes[1, n, 0] + planes[1, n, 1] * j + planes[1, n, 2] * k)
            for n in range(signs):
                if planes[2, n, 0] + planes[2, n, 1] * j + planes[2, n, 2] * k < 0.0:
                    high = -1.0
            if not low <= high:
                continue
            first, last = math.ceil(low), math.floor(high)
            if first > last:
                continue
            steps = last - first
            x = x0 + xi * first + xj * j + xk * k
            y = y0 + yi * first + yj * j + yk * k
            z = z0 + zi * first + zj * j + zk * k
            inside = _spans(x, steps * xi, nx) and _spans(y, steps * yi, ny) and _spans(z, steps * zi, nz)
            if inside and not only_air:
                at_x, at_y, at_z = np.int64(x * UNIT), np.int64(y * UNIT), np.int64(z * UNIT)
                for i in range(np.uint64(first), np.uint64(last + 1)):
                    out[np.uint64(k), np.uint64(j), i] = source[
                        np.uint64(at_z >> BITS), np.uint64(at_y >> BITS), np.uint64(at_x >> BITS)
                    ]
                    at_x += step_x
                    at_y += step_y
                    at_z += step_z
            else:
                written += _row_at_the_edge(source, x, y, z, xi, yi, zi, first, last, j, k, only_air, out)
    return written


@njit(cache=True, error_model="numpy")
def _row_at_the_edge(
    source: NDArray[np.uint8],
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    first: int,
    last: int,
    j: int,
    k: int,
    only_air: bool,
    out: NDArray[np.uint8],
) -> int:
    """Voxels first..last of row (j, k), some of which may lie beyond ``source``; x, y, z: place of the first. With
    ``only_air``: the number that became tissue."""
    nz, ny, nx = source.shape
    written = 0
    for i in range(first, last + 1):
        if only_air and out[k, j, i] != 0:
            continue
        step = i - first
        at_x = max(math.floor(x + step * dx), 0)
        at_y = math.floor(y + step * dy)
        at_z = math.floor(z + step * dz)
        if at_x < nx and 0 <= at_y < ny and 0 <= at_z < nz:
            out[k, j, i] = source[at_z, at_y, at_x]
            written += only_air and out[k, j, i] != 0
        elif not only_air:
            out[k, j, i] = 0
    return written


@njit(cache=True)
def _spans(start: float, change: float, size: int) -> bool:
    """True where start and start + change both lie in [0, size), by more than what rounding does on the way."""
    return min(start, start + change) >= ROUNDING and max(start, start + change) < size - ROUNDING


def census(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Voxels of every label, int64 (MAX_TISSUES,)."""
    unchanged = labels.view()
    unchanged.flags.writeable = False  # as those of the phantom: one kernel to compile, not two
    counts: NDArray[np.int64] = _census(unchanged).sum(axis=0)
    return counts


@njit(parallel=True, cache=True)
def _census(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    nz, ny, nx = labels.shape
    counts = np.zeros((nz, MAX_TISSUES), np.int64)
    whole = nx - nx % 8
    for k in prange(nz):
        table = np.zeros(256, np.int64)
        for j in range(ny):
            row = labels[k, j]
            # Neighbours are mostly alike: eight of them are one comparison.
            for first in range(0, whole, 8):
                word = word_at(row, first)
                if word == (word & np.uint64(255)) * EACH_BYTE:
                    table[word & np.uint64(255)] += 8
                else:
                    for i in range(first, first + 8):
                        table[row[i]] += 1
            for i in range(whole, nx):
                table[row[i]] += 1
        for tissue in range(MAX_TISSUES):
            counts[k, tissue] = table[tissue]
    return counts


@njit(parallel=True, cache=True)
def count_holes(labels: NDArray[np.uint8]) -> int:
    """Air voxels with tissue on all six sides."""
    nz, ny, nx = labels.shape
    holes = np.zeros(nz, np.int64)
    whole = nx - nx % 8
    for k in prange(1, nz - 1):
        for j in range(1, ny - 1):
            row = labels[k, j]
            for first in range(0, whole, 8):
                word = word_at(row, first)
                # All air, or no byte of it: most rows have nothing in between.
                if word != 0 and (word - EACH_BYTE) & ~word & (EACH_BYTE << np.uint64(7)):
                    holes[k] += _holes(labels, k, j, max(first, 1), min(first + 8, nx - 1))
            holes[k] += _holes(labels, k, j, max(whole, 1), nx - 1)
    return int(holes.sum())


@njit(cache=True)
def _holes(labels: NDArray[np.uint8], k: int, j: int, first: int, stop: int) -> int:
    """Holes of one voxel among the voxels first..stop - 1 of an inner row, none at its ends."""
    count = 0
    for i in range(first, stop):
        if labels[k, j, i] == 0:
            along_x = labels[k, j, i - 1] != 0 and labels[k, j, i + 1] != 0
            along_y = labels[k, j - 1, i] != 0 and labels[k, j + 1, i] != 0
            count += along_x and along_y and labels[k - 1, j, i] != 0 and labels[k + 1, j, i] != 0
    return count
