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
from numpy.typing import NDArray

from simcore.kernels import njit

Float32 = NDArray[np.float32]

X, Y, Z, SXX, SYY, SZZ, SXY, SXZ, SYZ, START, IDENTITY = range(11)
"""Rows of the table: centre (mm), S (1/mm^2), the delay at the centre (-2 c_i), the number of the seed."""
ROWS = 11

_ROUNDING = np.float32(1e-3)
"""Slack of the bounds for rounding in float32: delays near a block are of the order of 1 to 1000."""

_ZERO = np.float32(0)
_TWO = np.float32(2)


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
