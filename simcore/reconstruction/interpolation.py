"""Rows read at evenly spaced positions between their entries: what all kernels of this room share.

Everything outside a row or an array counts as zero: rows that are read along x are padded with zeros, and an index
row beyond an array has no weight. The source and the detector's x axis are parallel to the slices in every view, so
positions along x are the same for all rows of a slice.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
PADDING = 3
"""Zero entries of a padded row: one before the first pixel, two after the last."""


@njit(cache=True, error_model="numpy")
def column_positions(offset: float, step: float, columns: int, left: NDArray[np.int32], fraction: FloatArray) -> None:
    """Fill left[i], fraction[i]: position offset + i step lies so far after entry left[i] of a padded row.

    offset, step: in pixels, 0 being the centre of the first of ``columns`` pixels.
    """
    for i in range(len(left)):
        position = min(max(offset + i * step, -1.0), float(columns)) + 1.0
        left[i] = int(position)
        fraction[i] = position - left[i]


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


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def add_resampled(row: FloatArray, left: NDArray[np.int32], fraction: FloatArray, total: FloatArray) -> None:
    """total[i] += padded ``row`` at the position of left[i], fraction[i]."""
    for i in range(len(total)):
        # An unsigned index needs no test for negative values, which would keep the loop from being vectorised.
        u = np.uint64(left[i])
        total[i] += row[u] + fraction[i] * (row[u + np.uint64(1)] - row[u])


@njit(cache=True, error_model="numpy")
def scatter_resampled(values: FloatArray, left: NDArray[np.int32], fraction: FloatArray, row: FloatArray) -> None:
    """The transpose of add_resampled: row += values spread over the entries they would be read from."""
    for i in range(len(values)):
        u = np.uint64(left[i])
        right = fraction[i] * values[i]
        row[u] += values[i] - right
        row[u + np.uint64(1)] += right
