"""Interpolation between image rows. Rows beyond an image count as zero.

The source and the detector's x axis are parallel to the slices in
every view, so a row of voxels and a row of pixels see one another with one pair of row weights, and positions along
x are the same for all rows of a slice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit

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
