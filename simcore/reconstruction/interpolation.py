"""Interpolation between image rows, and the transpose of the interpolation along a row.

Everything outside a row or an array counts as zero. The source and the detector's x axis are parallel to the slices in
every view, so a row of voxels and a row of pixels see one another with one pair of row weights, and positions along
x are the same for all rows of a slice.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]


@njit(cache=True, error_model="numpy")
def row_weights(position: float, rows: int) -> tuple[int, int, float, float]:
    """(first, second, lower, upper): image row at ``position`` = lower image[first] + upper image[second].

    rows: number of image rows; those beyond have weight 0 (and an index that may be read).
    """
    row = int(np.floor(position))
    if row < -1 or row >= rows:
        return 0, 0, 0.0, 0.0
    upper = position - row
    lower = 1.0 - upper
    if row < 0:
        lower = 0.0
    if row == rows - 1:
        upper = 0.0
    return max(row, 0), min(row + 1, rows - 1), lower, upper


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def add_two_rows(
    first: FloatArray, second: FloatArray, lower: np.float32, upper: np.float32, total: FloatArray
) -> None:
    """total += lower first + upper second; all (n,)"""
    for i in range(len(total)):
        total[i] += lower * first[i] + upper * second[i]


@njit(cache=True, error_model="numpy")
def scatter_resampled(values: FloatArray, offset: float, step: float, row: FloatArray) -> None:
    """The transpose of ``lanes.add_resampled_rows`` for one row: row += values, each spread over the two entries that
    it would be read from.

    offset, step: position of the first of ``values`` and distance of the next, in entries of ``row``.
    """
    last = len(row) - 1
    for i in range(len(values)):
        position = offset + i * step
        left = int(np.floor(position))
        right = np.float32(position - left) * values[i]
        if 0 <= left <= last:
            row[left] += values[i] - right
        if -1 <= left < last:
            row[left + 1] += right
