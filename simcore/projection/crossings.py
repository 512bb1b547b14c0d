"""Where the rays of a detector row change from one column of voxels to the next (see ``plane_prefix``)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit

Columns = tuple[NDArray[np.float64], float, float, float, float]
"""Along x. At height z a ray is at the x cell source_cell + slope share(z), share(z) = (source_z - z) / source_z, with
slope = stretch pixel_x / edge. (pixel_x (pixels,) from the source, mm; edge of a voxel, mm; source_cell; share at the
bottom of the volume; decrease of share from slice to slice)."""

Crossings = tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32], NDArray[np.int32]]
"""Where the rays of a row cross the boundaries between voxel columns, slice by slice: start (slices + 1,) of each
slice in the three lists pixel, boundary and fraction (of the slice's height); within a slice pixels and so boundaries
ascend. Last (pixels,): the column at the top of the volume."""


@njit(cache=True, error_model="numpy")
def crossings_of(columns: Columns, stretch: float, slices: int, boundaries: int) -> Crossings:
    """The crossings of the boundaries 0..``boundaries`` by the rays of a row with the pitch ``stretch``."""
    pixel_x, edge, source_cell, share_bottom, share_step = columns
    slopes = pixel_x * (stretch / edge)
    pixels = len(slopes)
    start = np.zeros(slices + 1, np.uint32)
    last = np.full(pixels, -1, np.int32)
    total = 0
    pixel = np.empty(0, np.uint32)
    boundary = np.empty(0, np.uint32)
    fraction = np.empty(0, np.float32)
    position = np.zeros(slices, np.int64)
    for fill in range(2):
        if fill == 1:
            for k in range(slices):
                position[k] = total
                total += start[k + 1]
                start[k + 1] = total
            pixel = np.empty(total, np.uint32)
            boundary = np.empty(total, np.uint32)
            fraction = np.empty(total, np.float32)
        for v in range(pixels):
            bottom = source_cell + slopes[v] * share_bottom
            top = source_cell + slopes[v] * (share_bottom - slices * share_step)
            slices_per_column = 1.0 / (slopes[v] * share_step)
            lowest = -1
            for b in range(max(0, math.ceil(top)), min(boundaries, math.floor(bottom)) + 1):
                height = (bottom - b) * slices_per_column
                if height >= slices:
                    continue
                if lowest < 0:
                    lowest = b
                if height <= 0.0:
                    continue
                k = int(height)
                if fill == 0:
                    start[k + 1] += np.uint32(1)
                else:
                    at = position[k]
                    position[k] += 1
                    pixel[at], boundary[at], fraction[at] = v, b, height - k
            # From the list itself: rounding must not make the column at the top disagree with the crossings.
            last[v] = lowest - 1 if lowest >= 0 else min(math.floor(bottom), 2**30)
    return start, pixel, boundary, fraction, last
