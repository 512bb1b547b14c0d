"""The cells of oriented seeds on a sparse lattice of voxels: cheap estimates before every voxel is labelled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange
from simcore.phantom.cells import IDENTITY, ROWS, START, SXX, SXY, SXZ, SYY, SYZ, SZZ, Float32, X, Y, Z, keep_rivals
from simcore.phantom.outline import Outline
from simcore.phantom.texture import Texture, displaced, displaced_box

SAMPLES = 300_000
"""About how many lattice points lie in the tissue."""


@dataclass(frozen=True)
class Survey:
    """What stands at the lattice points inside the skin (every ``stride``-th voxel along each axis).

    first:  int32 (points,), the seed that wins.
    rival:  int32 (points,), the seed with which a ligament is drawn there, -1 where there is none.
    margin: float32 (points,), how much later than now all glandular seeds could start for the point to be still
            gland (negative: how much earlier they would have to start); -inf or inf where that is beyond the slack.
    point_ml: volume that a point stands for.
    """

    first: NDArray[np.int32]
    rival: NDArray[np.int32]
    margin: NDArray[np.float32]
    stride: int
    point_ml: float


def survey(
    outline: Outline, texture: Texture, seeds: Float32, gland_seeds: int, thickness: float, slack: float = 0.0
) -> Survey:
    """Evaluates the cells at lattice points.

    texture, seeds, gland_seeds, thickness: as in ``raster.label_voxels``; slack: reach of ``Survey.margin`` (delay).
    """
    stride = max(1, round((outline.tissue_voxels / SAMPLES) ** (1 / 3)))
    rows = np.ascontiguousarray(outline.tissue_rows[stride // 2 :: stride, stride // 2 :: stride])
    # Lattice points of a row: i = stride // 2 + stride * n < tissue_rows.
    rows = (np.maximum(0, rows - stride // 2) + stride - 1) // stride
    shape = (*rows.shape, int(rows.max(initial=0)))
    first = np.full(shape, -1, dtype=np.int32)
    rival = np.full(shape, -1, dtype=np.int32)
    margin = np.empty(shape, dtype=np.float32)
    step = outline.grid.spacing[0]
    start = [corner + (stride // 2 + 0.5) * step for corner in outline.grid.corner]
    _survey(
        texture,
        seeds,
        gland_seeds,
        thickness,
        slack,
        rows.astype(np.int32),
        step * stride,
        *start,
        first,
        rival,
        margin,
    )
    inside = first >= 0
    number = int(np.count_nonzero(inside))
    point_ml = outline.tissue_voxels * outline.grid.voxel_volume * 1e-3 / max(1, number)
    return Survey(first[inside], rival[inside], margin[inside], stride, point_ml)


@njit(cache=True, parallel=True, error_model="numpy")  # type: ignore[misc]
def _survey(texture, seeds, gland_seeds, thickness, slack, rows, step, x0, y0, z0, first, rival, margin):  # type: ignore[no-untyped-def]
    nz, ny = rows.shape
    n = seeds.shape[1]
    size = 8
    columns_y, columns_z = (ny + size - 1) // size, (nz + size - 1) // size
    reach, spare, pitch = np.float32(thickness), np.float32(slack), np.float32(step)
    half = np.float32((size - 1) / 2) * pitch
    quarter = np.float32((size // 2 - 1) / 2) * pitch
    for column in prange(columns_y * columns_z):
        k0, j0 = (column // columns_y) * size, (column % columns_y) * size
        work, steep = np.empty(n, np.float32), np.empty(n, np.float32)
        block, leaf = np.empty((ROWS, n), np.float32), np.empty((ROWS, n), np.float32)
        slope = np.empty((3, n), np.float32)
        deepest = 0
        for k in range(k0, min(nz, k0 + size)):
            for j in range(j0, min(ny, j0 + size)):
                deepest = max(deepest, rows[k, j])
        for i0 in range(0, deepest, size):
            x, y, z = np.float32(x0 + i0 * step), np.float32(y0 + j0 * step), np.float32(z0 + k0 * step)
            cx, cy, cz, hx, hy, hz = displaced_box(texture, x + half, y + half, z + half, half, half, half)
            in_block = keep_rivals(seeds, n, cx, cy, cz, hx, hy, hz, reach, spare, work, steep, block)
            for part in range(8):
                i1 = i0 + (part & 1) * 4
                j1, k1 = j0 + ((part >> 1) & 1) * 4, k0 + (part >> 2) * 4
                x, y, z = np.float32(x0 + i1 * step), np.float32(y0 + j1 * step), np.float32(z0 + k1 * step)
                cx, cy, cz, hx, hy, hz = displaced_box(
                    texture, x + quarter, y + quarter, z + quarter, quarter, quarter, quarter
                )
                in_leaf = keep_rivals(block, in_block, cx, cy, cz, hx, hy, hz, reach, spare, work, steep, leaf)
                for k in range(k1, min(nz, k1 + 4)):
                    for j in range(j1, min(ny, j1 + 4)):
                        for i in range(i1, min(rows[k, j], i1 + 4)):
                            x, y, z = np.float32(x0 + i * step), np.float32(y0 + j * step), np.float32(z0 + k * step)
                            x, y, z = displaced(texture, x, y, z)
                            first[k, j, i], rival[k, j, i], margin[k, j, i] = _point(
                                leaf, in_leaf, gland_seeds, x, y, z, reach, work, slope
                            )


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _point(seeds, count, gland_seeds, px, py, pz, thickness, delay, slope):  # type: ignore[no-untyped-def]
    """(winner, rival of a ligament or -1, margin) at one point."""
    best, best_gland = 0, -1
    for q in range(count):
        x, y, z = px - seeds[X, q], py - seeds[Y, q], pz - seeds[Z, q]
        slope[0, q] = seeds[SXX, q] * x + seeds[SXY, q] * y + seeds[SXZ, q] * z
        slope[1, q] = seeds[SXY, q] * x + seeds[SYY, q] * y + seeds[SYZ, q] * z
        slope[2, q] = seeds[SXZ, q] * x + seeds[SYZ, q] * y + seeds[SZZ, q] * z
        delay[q] = slope[0, q] * x + slope[1, q] * y + slope[2, q] * z + seeds[START, q]
        if delay[q] < delay[best]:
            best = q
        if seeds[IDENTITY, q] < gland_seeds:
            best_gland = q if best_gland < 0 or delay[q] < delay[best_gland] else best_gland
    nearest, rival, margin = np.float32(1.0), -1, np.float32(np.inf)
    for q in range(count):
        adipose = seeds[IDENTITY, q] >= gland_seeds
        if q != best and (adipose or seeds[IDENTITY, best] >= gland_seeds):
            distance = (delay[q] - delay[best]) / (thickness * _distance(slope, q, best))
            if distance < nearest:
                nearest, rival = distance, int(seeds[IDENTITY, q])
        if adipose and best_gland >= 0:
            lead = delay[q] - delay[best_gland] - thickness * _distance(slope, q, best_gland)
            margin = min(margin, lead)
    if best_gland < 0:
        margin = np.float32(-np.inf)
    return int(seeds[IDENTITY, best]), rival, margin


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[misc]
def _distance(slope, p, q):  # type: ignore[no-untyped-def]
    x, y, z = slope[0, p] - slope[0, q], slope[1, p] - slope[1, q], slope[2, p] - slope[2, q]
    return math.sqrt(x * x + y * y + z * z)
