"""Labels of a short row of voxels: every seed that its block kept, at every voxel, in vector registers.

See cells.py for the quantities. ``label_row`` is for points on a line, ``label_points`` for points anywhere.
"""

from __future__ import annotations

import numpy as np

from simcore.core.tissues import Tissue
from simcore.kernels import njit
from simcore.phantom.cells import START, SXX, SXY, SXZ, SYY, SYZ, SZZ, Float32, X, Y, Z

LANES = 16
"""Voxels along x that are labelled at once: one vector register of float32."""
_DELAY, _GX, _GY, _GZ, _WINNER, LABEL, PX, PY, PZ = range(0, 9 * LANES, LANES)
"""Offsets of the work array of a row: delay, half gradient and number of the winner; depth in ligaments, then label;
points of the row (x, y, z), where they are not on a line."""
WORK = 9 * LANES
"""Size of that array, float32."""

ADIPOSE, GLAND, LIGAMENT = (np.uint8(t) for t in (Tissue.ADIPOSE, Tissue.GLAND, Tissue.LIGAMENT))
_ZERO = np.float32(0)
_FAR = np.float32(1e30)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _along_row(seeds, q, x0, y, z):  # type: ignore[no-untyped-def]
    """What the delay and gradient of seed q need along x: offset, column of S, gradient and delay at offset 0."""
    dx, dy, dz = x0 - seeds[X, q], y - seeds[Y, q], z - seeds[Z, q]
    gx = seeds[SXY, q] * dy + seeds[SXZ, q] * dz
    gy = seeds[SYY, q] * dy + seeds[SYZ, q] * dz
    gz = seeds[SYZ, q] * dy + seeds[SZZ, q] * dz
    return dx, seeds[SXX, q], seeds[SXY, q], seeds[SXZ, q], gx, gy, gz, gy * dy + gz * dz + seeds[START, q]


@njit(cache=True, fastmath=True, error_model="numpy")
def label_row(
    seeds: Float32, count: int, glandular: int, x0: float, y: float, z: float, step: float, squared_thickness: float,
    lane: Float32,
) -> None:  # fmt: skip
    """Labels of LANES voxels along x from x0, left in lane[LABEL:].

    The first ``glandular`` of the ``count`` seeds are glandular. One work array with constant offsets lets the
    compiler see that nothing overlaps and keep the lanes in vector registers.
    """
    for i in range(LANES):
        lane[_DELAY + i] = _FAR
        lane[LABEL + i] = _ZERO
        lane[_GX + i] = _ZERO
        lane[_GY + i] = _ZERO
        lane[_GZ + i] = _ZERO
        lane[_WINNER + i] = _ZERO
    for q in range(count):
        dx, xx, xy, xz, gx0, gy0, gz0, delay0 = _along_row(seeds, q, x0, y, z)
        number = np.float32(q)
        for i in range(LANES):
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
        for i in range(LANES):
            x = dx + np.float32(i) * step
            gx, gy, gz = xx * x + gx0, xy * x + gy0, xz * x + gz0
            lead = x * (gx + gx0) + delay0 - lane[_DELAY + i]
            gx, gy, gz = gx - lane[_GX + i], gy - lane[_GY + i], gz - lane[_GZ + i]
            depth = squared_thickness * (gx * gx + gy * gy + gz * gz) - lead * lead
            depth = depth if lane[_WINNER + i] >= least_winner else _ZERO
            depth = depth if lane[_WINNER + i] != number else _ZERO
            lane[LABEL + i] = max(lane[LABEL + i], depth)
    _tissues(glandular, lane)


@njit(cache=True, fastmath=True, error_model="numpy")
def label_points(seeds: Float32, count: int, glandular: int, squared_thickness: float, lane: Float32) -> None:
    """As ``label_row`` for the points in lane[PX:], lane[PY:] and lane[PZ:]."""
    for i in range(LANES):
        lane[_DELAY + i] = _FAR
        lane[LABEL + i] = _ZERO
        lane[_GX + i] = _ZERO
        lane[_GY + i] = _ZERO
        lane[_GZ + i] = _ZERO
        lane[_WINNER + i] = _ZERO
    for q in range(count):
        sx, sy, sz, start = seeds[X, q], seeds[Y, q], seeds[Z, q], seeds[START, q]
        xx, yy, zz, xy, xz, yz = _metric(seeds, q)
        number = np.float32(q)
        for i in range(LANES):
            x, y, z = lane[PX + i] - sx, lane[PY + i] - sy, lane[PZ + i] - sz
            gx, gy, gz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
            delay = gx * x + gy * y + gz * z + start
            wins = delay < lane[_DELAY + i]
            lane[_DELAY + i] = delay if wins else lane[_DELAY + i]
            lane[_GX + i] = gx if wins else lane[_GX + i]
            lane[_GY + i] = gy if wins else lane[_GY + i]
            lane[_GZ + i] = gz if wins else lane[_GZ + i]
            lane[_WINNER + i] = number if wins else lane[_WINNER + i]
    for q in range(count):
        sx, sy, sz, start = seeds[X, q], seeds[Y, q], seeds[Z, q], seeds[START, q]
        xx, yy, zz, xy, xz, yz = _metric(seeds, q)
        number = np.float32(q)
        least_winner = np.float32(glandular) if q < glandular else _ZERO
        for i in range(LANES):
            x, y, z = lane[PX + i] - sx, lane[PY + i] - sy, lane[PZ + i] - sz
            gx, gy, gz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
            lead = gx * x + gy * y + gz * z + start - lane[_DELAY + i]
            gx, gy, gz = gx - lane[_GX + i], gy - lane[_GY + i], gz - lane[_GZ + i]
            depth = squared_thickness * (gx * gx + gy * gy + gz * gz) - lead * lead
            depth = depth if lane[_WINNER + i] >= least_winner else _ZERO
            depth = depth if lane[_WINNER + i] != number else _ZERO
            lane[LABEL + i] = max(lane[LABEL + i], depth)
    _tissues(glandular, lane)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _metric(seeds, q):  # type: ignore[no-untyped-def]
    """xx, yy, zz, xy, xz, yz of S."""
    return seeds[SXX, q], seeds[SYY, q], seeds[SZZ, q], seeds[SXY, q], seeds[SXZ, q], seeds[SYZ, q]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _tissues(glandular, lane):  # type: ignore[no-untyped-def]
    """Turns depths in ligaments and winners into labels."""
    for i in range(LANES):
        tissue = np.float32(GLAND) if lane[_WINNER + i] < np.float32(glandular) else np.float32(ADIPOSE)
        lane[LABEL + i] = np.float32(LIGAMENT) if lane[LABEL + i] > _ZERO else tissue
