"""Compartments as the cells of oriented seeds, evaluated block by block.

Region growing from oriented seeds gives each point to the seed with the largest
f_i(x) = -1/2 (x - m_i)' S_i (x - m_i) + c_i. The kernels use the *delay* D_i = -2 f_i, the smallest of which wins, and
its half gradient G_i = S_i (x - m_i). A Cooper's ligament of thickness t lies where a rival j is as near to winning
as |f_1 - f_j| / |grad(f_1 - f_j)| < t / 2, which is D_j - D_1 < t |G_j - G_1|. Glandular cells are one body: there
is no ligament between two of them.

A block of voxels keeps the seeds that can win or draw a ligament somewhere in it. Over a box the difference of two
delays is a quadratic whose linear and quadratic parts are bounded by the half extents, so the rest is dropped for
good, and smaller blocks start from what their parent kept.

Seeds are a float32 table (ROWS, n), one column a seed, glandular seeds first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from simcore.core.tissues import Tissue

Float32 = NDArray[np.float32]

X, Y, Z, SXX, SYY, SZZ, SXY, SXZ, SYZ, START, IDENTITY = range(11)
"""Rows of the table: centre (mm), S (1/mm^2), the delay at the centre (-2 c_i), the number of the seed."""
ROWS = 11

_ROUNDING = np.float32(1e-3)
"""Slack of the bounds for rounding in float32: delays near a block are of the order of 1 to 1000."""

_ADIPOSE, _GLAND, _SKIN, _LIGAMENT = (np.uint8(t) for t in (Tissue.ADIPOSE, Tissue.GLAND, Tissue.SKIN, Tissue.LIGAMENT))
_LANES = 16
"""Voxels along x that are labelled at once: one vector register of float32."""
_DELAY, _GX, _GY, _GZ, _WINNER, _LABEL = range(0, 6 * _LANES, _LANES)
"""Offsets of the work array of a row: delay, half gradient and number of the winner; depth in ligaments, then label."""
_TWO = np.float32(2)
_ZERO = np.float32(0)
_FAR = np.float32(1e30)


def seed_table(centres: NDArray[np.float64], metrics: NDArray[np.float64]) -> Float32:
    """The table of the kernels, all seeds starting at delay 0.

    centres: (n, 3), mm; metrics: S_i (n, 3, 3), 1/mm^2.
    """
    table = np.empty((ROWS, len(centres)), dtype=np.float32)
    table[X : Z + 1] = centres.T
    for row, i, j in ((SXX, 0, 0), (SYY, 1, 1), (SZZ, 2, 2), (SXY, 0, 1), (SXZ, 0, 2), (SYZ, 1, 2)):
        table[row] = metrics[:, i, j]
    table[START] = 0.0
    table[IDENTITY] = np.arange(len(centres))
    return table


@njit(cache=True, fastmath=True, error_model="numpy")  # type: ignore[misc]
def keep_rivals(
    seeds: Float32, count: int, cx: float, cy: float, cz: float, hx: float, hy: float, hz: float,
    thickness: float, slack: float, delay: Float32, steep: Float32, kept: Float32,
) -> int:  # fmt: skip
    """Copies to ``kept`` the first ``count`` seeds that matter somewhere in the box (centre c, half extents h), and
    returns how many they are.

    slack: delays are compared as if each could still be changed by that much.
    delay, steep: work arrays of ``count``.
    """
    for q in range(count):
        x, y, z = cx - seeds[X, q], cy - seeds[Y, q], cz - seeds[Z, q]
        gx = seeds[SXX, q] * x + seeds[SXY, q] * y + seeds[SXZ, q] * z
        gy = seeds[SXY, q] * x + seeds[SYY, q] * y + seeds[SYZ, q] * z
        gz = seeds[SXZ, q] * x + seeds[SYZ, q] * y + seeds[SZZ, q] * z
        delay[q] = gx * x + gy * y + gz * z + seeds[START, q]
    best = 0
    for q in range(count):
        if delay[q] < delay[best]:
            best = q
    best_delay = delay[best]
    bxx, byy, bzz = seeds[SXX, best], seeds[SYY, best], seeds[SZZ, best]
    bxy, bxz, byz = seeds[SXY, best], seeds[SXZ, best], seeds[SYZ, best]
    x, y, z = cx - seeds[X, best], cy - seeds[Y, best], cz - seeds[Z, best]
    bgx, bgy, bgz = bxx * x + bxy * y + bxz * z, bxy * x + byy * y + byz * z, bxz * x + byz * y + bzz * z
    for q in range(count):
        x, y, z = cx - seeds[X, q], cy - seeds[Y, q], cz - seeds[Z, q]
        gx = seeds[SXX, q] * x + seeds[SXY, q] * y + seeds[SXZ, q] * z - bgx
        gy = seeds[SXY, q] * x + seeds[SYY, q] * y + seeds[SYZ, q] * z - bgy
        gz = seeds[SXZ, q] * x + seeds[SYZ, q] * y + seeds[SZZ, q] * z - bgz
        xx, yy, zz = seeds[SXX, q] - bxx, seeds[SYY, q] - byy, seeds[SZZ, q] - bzz
        xy, xz, yz = abs(seeds[SXY, q] - bxy), abs(seeds[SXZ, q] - bxz), abs(seeds[SYZ, q] - byz)
        linear = _TWO * (abs(gx) * hx + abs(gy) * hy + abs(gz) * hz)
        square = max(_ZERO, -xx) * hx * hx + max(_ZERO, -yy) * hy * hy + max(_ZERO, -zz) * hz * hz
        mixed = _TWO * (xy * hx * hy + xz * hx * hz + yz * hy * hz)
        # Least lead of the best seed over this one in the box, and their largest difference of gradients there.
        delay[q] = delay[q] - best_delay - linear - square - mixed - slack - _ROUNDING
        gx = abs(gx) + abs(xx) * hx + xy * hy + xz * hz
        gy = abs(gy) + xy * hx + abs(yy) * hy + yz * hz
        gz = abs(gz) + xz * hx + yz * hy + abs(zz) * hz
        steep[q] = math.sqrt(gx * gx + gy * gy + gz * gz)
    steepest_winner = _ZERO
    for q in range(count):
        if delay[q] <= _ZERO:
            steepest_winner = max(steepest_winner, steep[q])
    number = 0
    for q in range(count):
        if q == best or delay[q] <= thickness * (steep[q] + steepest_winner):
            for row in range(ROWS):
                kept[row, number] = seeds[row, q]
            number += 1
    return number


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")  # type: ignore[misc]
def _along_row(seeds, q, x0, y, z):  # type: ignore[no-untyped-def]
    """What the delay and gradient of seed q need along x: offset, column of S, gradient and delay at offset 0."""
    dx, dy, dz = x0 - seeds[X, q], y - seeds[Y, q], z - seeds[Z, q]
    gx = seeds[SXY, q] * dy + seeds[SXZ, q] * dz
    gy = seeds[SYY, q] * dy + seeds[SYZ, q] * dz
    gz = seeds[SYZ, q] * dy + seeds[SZZ, q] * dz
    return dx, seeds[SXX, q], seeds[SXY, q], seeds[SXZ, q], gx, gy, gz, gy * dy + gz * dz + seeds[START, q]


@njit(cache=True, fastmath=True, error_model="numpy")  # type: ignore[misc]
def _label_row(
    seeds: Float32, count: int, glandular: int, x0: float, y: float, z: float, step: float, squared_thickness: float,
    lane: Float32,
) -> None:  # fmt: skip
    """Labels of _LANES voxels along x from x0, left in lane[_LABEL:].

    The first ``glandular`` of the ``count`` seeds are glandular. One work array with constant offsets lets the
    compiler see that nothing overlaps and keep the lanes in vector registers.
    """
    for i in range(_LANES):
        lane[_DELAY + i] = _FAR
        lane[_LABEL + i] = _ZERO
        lane[_GX + i] = _ZERO
        lane[_GY + i] = _ZERO
        lane[_GZ + i] = _ZERO
        lane[_WINNER + i] = _ZERO
    for q in range(count):
        dx, xx, xy, xz, gx0, gy0, gz0, delay0 = _along_row(seeds, q, x0, y, z)
        number = np.float32(q)
        for i in range(_LANES):
            x = dx + np.float32(i) * step
            gx, gy, gz = xx * x + gx0, xy * x + gy0, xz * x + gz0
            delay = x * (gx + gx0) + delay0
            wins = delay < lane[_DELAY + i]
            lane[_DELAY + i] = delay if wins else lane[_DELAY + i]
            lane[_GX + i] = gx if wins else lane[_GX + i]
            lane[_GY + i] = gy if wins else lane[_GY + i]
            lane[_GZ + i] = gz if wins else lane[_GZ + i]
            lane[_WINNER + i] = number if wins else lane[_WINNER + i]
    for q in range(count):
        dx, xx, xy, xz, gx0, gy0, gz0, delay0 = _along_row(seeds, q, x0, y, z)
        number = np.float32(q)
        # A glandular rival draws no ligament against a glandular winner.
        least_winner = np.float32(glandular) if q < glandular else _ZERO
        for i in range(_LANES):
            x = dx + np.float32(i) * step
            gx, gy, gz = xx * x + gx0, xy * x + gy0, xz * x + gz0
            lead = x * (gx + gx0) + delay0 - lane[_DELAY + i]
            gx, gy, gz = gx - lane[_GX + i], gy - lane[_GY + i], gz - lane[_GZ + i]
            depth = squared_thickness * (gx * gx + gy * gy + gz * gz) - lead * lead
            depth = depth if lane[_WINNER + i] >= least_winner else _ZERO
            depth = depth if lane[_WINNER + i] != number else _ZERO
            lane[_LABEL + i] = max(lane[_LABEL + i], depth)
    for i in range(_LANES):
        tissue = np.float32(_GLAND) if lane[_WINNER + i] < np.float32(glandular) else np.float32(_ADIPOSE)
        lane[_LABEL + i] = np.float32(_LIGAMENT) if lane[_LABEL + i] > _ZERO else tissue


class _Raster(NamedTuple):
    """What the kernels write to and where it lies."""

    labels: NDArray[np.uint8]
    tissue_rows: NDArray[np.int32]
    step: np.float32
    y0: np.float32
    z0: np.float32
    thickness: np.float32
    gland_seeds: int


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _glandular(seeds: Float32, count: int, gland_seeds: int) -> int:
    """How many of the first ``count`` seeds are glandular (they come first)."""
    number = 0
    while number < count and seeds[IDENTITY, number] < gland_seeds:
        number += 1
    return number


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _narrow(
    raster: _Raster, seeds: Float32, count: int, i0: int, j0: int, k0: int, width: int, height: int, work: Float32,
    kept: Float32,
) -> int:  # fmt: skip
    """Narrows the seeds down to those that matter in a block of width x height x height voxels.

    returns: how many are in ``kept``; 0 where the block is settled: outside the tissue, or of one tissue and filled.
    """
    k1, j1 = min(raster.labels.shape[0], k0 + height), min(raster.labels.shape[1], j0 + height)
    deepest = 0
    for k in range(k0, k1):
        for j in range(j0, j1):
            deepest = max(deepest, raster.tissue_rows[k, j])
    if i0 >= deepest:
        return 0
    half_x, half_y = np.float32(0.5 * width) * raster.step, np.float32(0.5 * height) * raster.step
    number: int = keep_rivals(
        seeds, count,
        np.float32(i0) * raster.step + half_x,
        raster.y0 + np.float32(j0) * raster.step + half_y,
        raster.z0 + np.float32(k0) * raster.step + half_y,
        half_x, half_y, half_y, raster.thickness, _ZERO, work[0], work[1], kept,
    )  # fmt: skip
    glandular = _glandular(kept, number, raster.gland_seeds)
    if number > 1 and glandular < number:
        return number
    tissue = _GLAND if glandular else _ADIPOSE
    for k in range(k0, k1):
        for j in range(j0, j1):
            for i in range(i0, min(i0 + width, raster.tissue_rows[k, j])):
                raster.labels[k, j, i] = tissue
    return 0


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _label_leaf(
    raster: _Raster, seeds: Float32, count: int, i0: int, j0: int, k0: int, height: int, lane: Float32
) -> None:
    """Labels _LANES x height x height voxels one by one."""
    half = np.float32(0.5) * raster.step
    glandular = _glandular(seeds, count, raster.gland_seeds)
    squared_thickness = raster.thickness * raster.thickness
    for k in range(k0, min(raster.labels.shape[0], k0 + height)):
        for j in range(j0, min(raster.labels.shape[1], j0 + height)):
            length = min(_LANES, raster.tissue_rows[k, j] - i0)
            if length <= 0:
                continue
            x = np.float32(i0) * raster.step + half
            y = raster.y0 + np.float32(j) * raster.step + half
            z = raster.z0 + np.float32(k) * raster.step + half
            _label_row(seeds, count, glandular, x, y, z, raster.step, squared_thickness, lane)
            for i in range(length):
                raster.labels[k, j, i0 + i] = np.uint8(lane[_LABEL + i])


@njit(cache=True, parallel=True, error_model="numpy")  # type: ignore[misc]
def label_voxels(
    seeds: Float32, gland_seeds: int, thickness: float, tissue_rows: NDArray[np.int32],
    breast_rows: NDArray[np.int32], spacing: float, corner_y: float, corner_z: float, labels: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Writes adipose, gland, ligament and skin into ``labels`` (nz, ny, nx), which comes as air.

    seeds: table (ROWS, n), the first ``gland_seeds`` glandular; thickness: of the ligaments, mm.
    tissue_rows, breast_rows: (nz, ny), see Outline; spacing, corner_y, corner_z: of the grid, mm.
    One task writes the voxels of one column of 16 x 16 rows, by halving blocks of 64 x 16 x 16 twice.
    """
    raster = _Raster(
        labels, tissue_rows, np.float32(spacing), np.float32(corner_y), np.float32(corner_z), np.float32(thickness),
        gland_seeds,
    )  # fmt: skip
    columns_y, columns_z = (labels.shape[1] + 15) // 16, (labels.shape[0] + 15) // 16
    columns = columns_y * columns_z
    stride = _spread(columns)
    for task in prange(columns):
        column = (task * stride) % columns
        k0, j0 = (column // columns_y) * 16, (column % columns_y) * 16
        n = seeds.shape[1]
        work, lane = np.empty((2, n), np.float32), np.empty(6 * _LANES, np.float32)
        large = np.empty((ROWS, n), np.float32)
        small, leaf = np.empty_like(large), np.empty_like(large)
        for i0 in range(0, labels.shape[2], 64):
            in_large = _narrow(raster, seeds, n, i0, j0, k0, 64, 16, work, large)
            for part in range(8 if in_large else 0):
                i1, j1, k1 = i0 + (part & 1) * 32, j0 + (part >> 1 & 1) * 8, k0 + (part >> 2) * 8
                in_small = _narrow(raster, large, in_large, i1, j1, k1, 32, 8, work, small)
                for piece in range(8 if in_small else 0):
                    i2, j2, k2 = i1 + (piece & 1) * 16, j1 + (piece >> 1 & 1) * 4, k1 + (piece >> 2) * 4
                    in_leaf = _narrow(raster, small, in_small, i2, j2, k2, 16, 4, work, leaf)
                    if in_leaf:
                        _label_leaf(raster, leaf, in_leaf, i2, j2, k2, 4, lane)
        _label_skin(labels, tissue_rows, breast_rows, j0, k0)


@njit(cache=True)  # type: ignore[misc]
def _label_skin(
    labels: NDArray[np.uint8], tissue_rows: NDArray[np.int32], breast_rows: NDArray[np.int32], j0: int, k0: int
) -> None:
    for k in range(k0, min(labels.shape[0], k0 + 16)):
        for j in range(j0, min(labels.shape[1], j0 + 16)):
            for i in range(tissue_rows[k, j], breast_rows[k, j]):
                labels[k, j, i] = _SKIN


@njit(cache=True)  # type: ignore[misc]
def _spread(count: int) -> int:
    """A stride coprime to ``count`` near the golden section, so that equal shares of tasks are equal work."""
    stride = max(1, int(count * 0.618))
    while math.gcd(stride, count) != 1:
        stride += 1
    return stride
