"""Labels of every voxel: blocks that are halved until they are settled or small enough to be labelled one by one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange
from simcore.phantom.cells import IDENTITY, ROWS, Float32, keep_rivals
from simcore.phantom.rows import ADIPOSE, GLAND, LABEL, LANES, WORK, label_points, label_row
from simcore.phantom.texture import Texture, displace_row, displaced_box

COLUMN = 16
"""Voxels along y and z of a column of blocks, one task. Slabs that begin at a multiple of it have the same blocks."""
_ZERO = np.float32(0)


class _Raster(NamedTuple):
    """What the kernels write to and where it lies."""

    labels: NDArray[np.uint8]
    tissue_rows: NDArray[np.int32]
    step: np.float32
    y0: np.float32
    z0: np.float32
    first_slice: int
    thickness: np.float32
    gland_seeds: int


@njit(cache=True, error_model="numpy")
def _glandular(seeds: Float32, count: int, gland_seeds: int) -> int:
    """How many of the first ``count`` seeds are glandular (they come first)."""
    number = 0
    while number < count and seeds[IDENTITY, number] < gland_seeds:
        number += 1
    return number


@njit(cache=True, error_model="numpy")
def _narrow(
    raster: _Raster, texture: Texture, seeds: Float32, count: int, i0: int, j0: int, k0: int, width: int, height: int,
    work: Float32, kept: Float32,
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
    cx, cy, cz, hx, hy, hz = displaced_box(
        texture,
        np.float32(i0) * raster.step + half_x,
        raster.y0 + np.float32(j0) * raster.step + half_y,
        raster.z0 + np.float32(k0 + raster.first_slice) * raster.step + half_y,
        half_x,
        half_y,
        half_y,
    )
    number: int = keep_rivals(
        seeds, count, cx, cy, cz, hx, hy, hz, raster.thickness, _ZERO, work[0], work[1], kept
    )  # fmt: skip
    glandular = _glandular(kept, number, raster.gland_seeds)
    if number > 1 and glandular < number:
        return number
    tissue = GLAND if glandular else ADIPOSE
    for k in range(k0, k1):
        for j in range(j0, j1):
            for i in range(i0, min(i0 + width, raster.tissue_rows[k, j])):
                raster.labels[k, j, i] = tissue
    return 0


@njit(cache=True, error_model="numpy")
def _label_leaf(
    raster: _Raster, texture: Texture, seeds: Float32, count: int, i0: int, j0: int, k0: int, height: int, lane: Float32
) -> None:
    """Labels LANES x height x height voxels one by one."""
    half = np.float32(0.5) * raster.step
    glandular = _glandular(seeds, count, raster.gland_seeds)
    squared_thickness = raster.thickness * raster.thickness
    plain = texture.field.shape[1] == 0
    for k in range(k0, min(raster.labels.shape[0], k0 + height)):
        for j in range(j0, min(raster.labels.shape[1], j0 + height)):
            length = min(LANES, raster.tissue_rows[k, j] - i0)
            if length <= 0:
                continue
            x = np.float32(i0) * raster.step + half
            y = raster.y0 + np.float32(j) * raster.step + half
            z = raster.z0 + np.float32(k + raster.first_slice) * raster.step + half
            if plain:
                label_row(seeds, count, glandular, x, y, z, raster.step, squared_thickness, lane)
            else:
                displace_row(texture, x, y, z, raster.step, lane)
                label_points(seeds, count, glandular, squared_thickness, lane)
            for i in range(length):
                raster.labels[k, j, i0 + i] = np.uint8(lane[LABEL + i])


@njit(cache=True, parallel=True, error_model="numpy")
def label_voxels(
    seeds: Float32, gland_seeds: int, thickness: float, texture: Texture, tissue_rows: NDArray[np.int32],
    breast_rows: NDArray[np.int32], cover: NDArray[np.uint8], spacing: float, corner_y: float, corner_z: float,
    first_slice: int, labels: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Writes adipose, gland, ligament and what covers them into ``labels`` (nz, ny, nx), which comes as air.

    seeds: table (ROWS, n), the first ``gland_seeds`` glandular; thickness: of the ligaments, mm.
    tissue_rows, breast_rows, cover: (nz, ny), see Outline; spacing, corner_y, corner_z: of the whole grid, mm.
    first_slice: where ``labels`` and the rows begin in the whole grid, a multiple of COLUMN.
    One task writes the voxels of one column of 16 x 16 rows, by halving blocks of 64 x 16 x 16 twice.
    """
    raster = _Raster(
        labels, tissue_rows, np.float32(spacing), np.float32(corner_y), np.float32(corner_z), first_slice,
        np.float32(thickness), gland_seeds,
    )  # fmt: skip
    columns_y, columns_z = (labels.shape[1] + 15) // 16, (labels.shape[0] + 15) // 16
    columns = columns_y * columns_z
    stride = _spread(columns)
    for task in prange(columns):
        column = (task * stride) % columns
        k0, j0 = (column // columns_y) * 16, (column % columns_y) * 16
        n = seeds.shape[1]
        work, lane = np.empty((2, n), np.float32), np.empty(WORK, np.float32)
        large = np.empty((ROWS, n), np.float32)
        small, leaf = np.empty_like(large), np.empty_like(large)
        for i0 in range(0, labels.shape[2], 64):
            in_large = _narrow(raster, texture, seeds, n, i0, j0, k0, 64, 16, work, large)
            for part in range(8 if in_large else 0):
                i1, j1, k1 = i0 + (part & 1) * 32, j0 + (part >> 1 & 1) * 8, k0 + (part >> 2) * 8
                in_small = _narrow(raster, texture, large, in_large, i1, j1, k1, 32, 8, work, small)
                for piece in range(8 if in_small else 0):
                    i2, j2, k2 = i1 + (piece & 1) * 16, j1 + (piece >> 1 & 1) * 4, k1 + (piece >> 2) * 4
                    in_leaf = _narrow(raster, texture, small, in_small, i2, j2, k2, 16, 4, work, leaf)
                    if in_leaf:
                        _label_leaf(raster, texture, leaf, in_leaf, i2, j2, k2, 4, lane)
        _label_cover(labels, tissue_rows, breast_rows, cover, j0, k0)


@njit(cache=True)
def _label_cover(
    labels: NDArray[np.uint8], tissue_rows: NDArray[np.int32], breast_rows: NDArray[np.int32],
    cover: NDArray[np.uint8], j0: int, k0: int,
) -> None:  # fmt: skip
    for k in range(k0, min(labels.shape[0], k0 + COLUMN)):
        for j in range(j0, min(labels.shape[1], j0 + COLUMN)):
            for i in range(tissue_rows[k, j], breast_rows[k, j]):
                labels[k, j, i] = cover[k, j]


@njit(cache=True)
def _spread(count: int) -> int:
    """A stride coprime to ``count`` near the golden section, so that equal shares of tasks are equal work."""
    stride = max(1, int(count * 0.618))
    while math.gcd(stride, count) != 1:
        stride += 1
    return stride
