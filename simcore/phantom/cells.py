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
_TWO = np.float32(2)
_ZERO = np.float32(0)
_FAR = np.float32(1e30)


def seed_table(centres: NDArray[np.float64], metrics: NDArray[np.float64], starts: NDArray[np.float64]) -> Float32:
    """The table of the kernels.

    centres: (n, 3), mm; metrics: S_i (n, 3, 3), 1/mm^2; starts: (n,), delay at the centre.
    """
    table = np.empty((ROWS, len(centres)), dtype=np.float32)
    table[X : Z + 1] = centres.T
    for row, i, j in ((SXX, 0, 0), (SYY, 1, 1), (SZZ, 2, 2), (SXY, 0, 1), (SXZ, 0, 2), (SYZ, 1, 2)):
        table[row] = metrics[:, i, j]
    table[START] = starts
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


@njit(cache=True, fastmath=True, error_model="numpy")  # type: ignore[misc]
def _label_row(
    seeds: Float32, count: int, glandular: int, x0: float, y: float, z: float, step: float, squared_thickness: float,
    lanes: int, delay: Float32, gx: Float32, gy: Float32, gz: Float32, first: Float32, fx: Float32, fy: Float32,
    fz: Float32, gland_first: Float32, label: Float32,
) -> None:  # fmt: skip
    """Labels of ``lanes`` voxels along x from x0; the first ``glandular`` of the seeds are glandular."""
    for i in range(lanes):
        first[i] = _FAR
        gland_first[i] = _FAR
        fx[i] = _ZERO
        fy[i] = _ZERO
        fz[i] = _ZERO
    for q in range(count):
        xx, xy, xz = seeds[SXX, q], seeds[SXY, q], seeds[SXZ, q]
        dx, dy, dz = x0 - seeds[X, q], y - seeds[Y, q], z - seeds[Z, q]
        gx0 = xy * dy + xz * dz
        gy0 = seeds[SYY, q] * dy + seeds[SYZ, q] * dz
        gz0 = seeds[SYZ, q] * dy + seeds[SZZ, q] * dz
        rest = gy0 * dy + gz0 * dz + seeds[START, q]
        at = q * _LANES
        for i in range(lanes):
            x = dx + np.float32(i) * step
            this_x, this_y, this_z = xx * x + gx0, xy * x + gy0, xz * x + gz0
            this = x * (this_x + gx0) + rest
            delay[at + i] = this
            gx[at + i] = this_x
            gy[at + i] = this_y
            gz[at + i] = this_z
            wins = this < first[i]
            first[i] = this if wins else first[i]
            fx[i] = this_x if wins else fx[i]
            fy[i] = this_y if wins else fy[i]
            fz[i] = this_z if wins else fz[i]
        if q == glandular - 1:
            for i in range(lanes):
                gland_first[i] = first[i]
    for i in range(lanes):
        label[i] = np.float32(_GLAND) if gland_first[i] <= first[i] else np.float32(_ADIPOSE)
        gland_first[i] = _ZERO if gland_first[i] <= first[i] else squared_thickness
    for q in range(count):
        at = q * _LANES
        for i in range(lanes):
            lead = delay[at + i] - first[i]
            x, y_, z_ = gx[at + i] - fx[i], gy[at + i] - fy[i], gz[at + i] - fz[i]
            reach = gland_first[i] if q < glandular else squared_thickness
            near = lead * lead < reach * (x * x + y_ * y_ + z_ * z_)
            label[i] = np.float32(_LIGAMENT) if near else label[i]


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _glandular(seeds: Float32, count: int, gland_seeds: int) -> int:
    """How many of the first ``count`` seeds are glandular (they come first)."""
    number = 0
    while number < count and seeds[IDENTITY, number] < gland_seeds:
        number += 1
    return number


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _fill(labels, rows, value, k0, k1, j0, j1, i0, i1):  # type: ignore[no-untyped-def]
    for k in range(k0, k1):
        for j in range(j0, j1):
            for i in range(i0, min(i1, rows[k, j])):
                labels[k, j, i] = value


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")  # type: ignore[misc]
def label_voxels(
    seeds: Float32, gland_seeds: int, thickness: float, tissue_rows: NDArray[np.int32],
    breast_rows: NDArray[np.int32], spacing: float, corner_y: float, corner_z: float, labels: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Writes adipose, gland, ligament and skin into ``labels`` (nz, ny, nx), which comes as air.

    seeds: table (ROWS, n), the first ``gland_seeds`` glandular; thickness: of the ligaments, mm.
    tissue_rows, breast_rows: (nz, ny), see Outline. One task writes one column of 16 x 16 rows.
    """
    nz, ny, nx = labels.shape
    n = seeds.shape[1]
    columns_y, columns_z = (ny + 15) // 16, (nz + 15) // 16
    columns = columns_y * columns_z
    stride = _spread(columns)
    step, ligament = np.float32(spacing), np.float32(thickness)
    half = np.float32(0.5) * step
    for task in prange(columns):
        column = (task * stride) % columns
        k0, j0 = (column // columns_y) * 16, (column % columns_y) * 16
        k1, j1 = min(nz, k0 + 16), min(ny, j0 + 16)
        deepest = 0
        for k in range(k0, k1):
            for j in range(j0, j1):
                deepest = max(deepest, tissue_rows[k, j])
                for i in range(tissue_rows[k, j], breast_rows[k, j]):
                    labels[k, j, i] = _SKIN
        delay, steep = np.empty(n, np.float32), np.empty(n, np.float32)
        large, small, leaf = (
            np.empty((ROWS, n), np.float32), np.empty((ROWS, n), np.float32), np.empty((ROWS, n), np.float32)
        )  # fmt: skip
        work = np.empty((4, n * _LANES), np.float32)
        lane = np.empty((6, _LANES), np.float32)
        for i0 in range(0, deepest, 64):
            in_large = keep_rivals(
                seeds, n, np.float32(i0 + 32) * step, np.float32(corner_y) + np.float32(j0 + 8) * step,
                np.float32(corner_z) + np.float32(k0 + 8) * step, np.float32(64) * half, np.float32(16) * half, np.float32(16) * half, ligament, _ZERO,
                delay, steep, large,
            )  # fmt: skip
            gland = _glandular(large, in_large, gland_seeds)
            if in_large == 1 or gland == in_large:
                _fill(labels, tissue_rows, _GLAND if gland else _ADIPOSE, k0, k1, j0, j1, i0, i0 + 64)
                continue
            for part in range(8):
                i1 = i0 + (part & 1) * 32
                j2, k2 = j0 + ((part >> 1) & 1) * 8, k0 + (part >> 2) * 8
                j3, k3 = min(ny, j2 + 8), min(nz, k2 + 8)
                deepest_part = 0
                for k in range(k2, k3):
                    for j in range(j2, j3):
                        deepest_part = max(deepest_part, tissue_rows[k, j])
                if i1 >= deepest_part:
                    continue
                in_small = keep_rivals(
                    large, in_large, np.float32(i1 + 16) * step, np.float32(corner_y) + np.float32(j2 + 4) * step,
                    np.float32(corner_z) + np.float32(k2 + 4) * step, np.float32(32) * half, np.float32(8) * half, np.float32(8) * half, ligament, _ZERO,
                    delay, steep, small,
                )  # fmt: skip
                gland = _glandular(small, in_small, gland_seeds)
                if in_small == 1 or gland == in_small:
                    _fill(labels, tissue_rows, _GLAND if gland else _ADIPOSE, k2, k3, j2, j3, i1, i1 + 32)
                    continue
                for piece in range(8):
                    i2 = i1 + (piece & 1) * 16
                    j4, k4 = j2 + ((piece >> 1) & 1) * 4, k2 + (piece >> 2) * 4
                    j5, k5 = min(ny, j4 + 4), min(nz, k4 + 4)
                    if i2 >= deepest_part:
                        continue
                    in_leaf = keep_rivals(
                        small, in_small, np.float32(i2 + 8) * step, np.float32(corner_y) + np.float32(j4 + 2) * step,
                        np.float32(corner_z) + np.float32(k4 + 2) * step, np.float32(16) * half, np.float32(4) * half, np.float32(4) * half, ligament, _ZERO,
                        delay, steep, leaf,
                    )  # fmt: skip
                    gland = _glandular(leaf, in_leaf, gland_seeds)
                    if in_leaf == 1 or gland == in_leaf:
                        _fill(labels, tissue_rows, _GLAND if gland else _ADIPOSE, k4, k5, j4, j5, i2, i2 + 16)
                        continue
                    for k in range(k4, k5):
                        for j in range(j4, j5):
                            if i2 >= tissue_rows[k, j]:
                                continue
                            _label_row(
                                leaf, in_leaf, gland, np.float32(i2) * step + half, np.float32(corner_y) + np.float32(j) * step + half,
                                np.float32(corner_z) + np.float32(k) * step + half, step, ligament * ligament, _LANES,
                                work[0], work[1], work[2], work[3], lane[0], lane[1], lane[2], lane[3], lane[4],
                                lane[5],
                            )  # fmt: skip
                            for i in range(min(_LANES, tissue_rows[k, j] - i2)):
                                labels[k, j, i2 + i] = np.uint8(lane[5, i])


@njit(cache=True)  # type: ignore[misc]
def _spread(count: int) -> int:
    """A stride coprime to ``count`` near the golden section, so that equal shares of tasks are equal work."""
    stride = max(1, int(count * 0.618))
    while math.gcd(stride, count) != 1:
        stride += 1
    return stride
