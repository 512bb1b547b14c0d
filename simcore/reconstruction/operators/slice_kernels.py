"""Compiled halves of the operator pair: rays through slices that lie parallel to the detector.

Both interpolate linearly along y first (whole rows at a time, one pair of weights a row) and along x then, eight rows
at a time (``lanes``). Views whose sources share x and z read along x at the same positions: ``gather_rows`` adds their
rows before it resamples. Lengths of rays are not in here: weights are those of interpolation alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange
from simcore.reconstruction.operators.interpolation import add_two_rows, row_weights
from simcore.reconstruction.operators.lanes import ROWS, add_resampled_rows

FloatArray = NDArray[np.float32]
Coordinates = NDArray[np.float64]

# Plain tuples, for numba cannot hand named ones to its threads.

Gathering = tuple[NDArray[np.int64], NDArray[np.int64], Coordinates, Coordinates, int, int]
"""How ``gather_rows`` reads projections: order (views,), group_start (groups + 1,): views of one group stand together
in ``order``; offsets, steps (views, nz, 2), see ``operators.Crossings``; pad and width of rows."""


@njit(cache=True, parallel=True, error_model="numpy")
def project_view(
    volume: FloatArray, offset: Coordinates, step: Coordinates, pad: int, width: int, projection: FloatArray
) -> None:
    """Fill float32 (ny, nx) of one view with sums over slices; ROWS detector rows belong to one thread."""
    nz, ny, nx = volume.shape
    detector_rows, columns = projection.shape
    for block in prange((detector_rows + ROWS - 1) // ROWS):
        j0 = block * ROWS
        count = min(ROWS, detector_rows - j0)
        crossed = np.zeros((ROWS, nx + 2 * pad), np.float32)
        sums = np.zeros((ROWS, width), np.float32)
        for z in range(nz):
            low, high = offset[z, 0] + j0 * step[z, 0], offset[z, 0] + (j0 + count - 1) * step[z, 0]
            if high <= -1.0 or low >= ny:
                continue
            for r in range(count):
                row = crossed[r, pad : pad + nx]
                first, second, lower, upper = row_weights(offset[z, 0] + (j0 + r) * step[z, 0], ny)
                set_two_rows(volume[z, first], volume[z, second], np.float32(lower), np.float32(upper), row)
            add_resampled_rows(crossed, pad, offset[z, 1], step[z, 1], 1.0, sums)
        projection[j0 : j0 + count] = sums[:count, :columns]


@njit(cache=True, parallel=True, error_model="numpy")
def backproject_views(projections: FloatArray, gathering: Gathering, volume: FloatArray) -> None:
    """Fill float32 (nz, ny, nx) from float32 (views, ny, nx); ROWS voxel rows of every slice belong to one thread."""
    nz, ny, nx = volume.shape
    pad, width = gathering[4], gathering[5]
    for block in prange((ny + ROWS - 1) // ROWS):
        y0 = block * ROWS
        count = min(ROWS, ny - y0)
        summed = np.zeros((ROWS, projections.shape[2] + 2 * pad), np.float32)
        total = np.empty((ROWS, width), np.float32)
        for z in range(nz):
            gather_rows(projections, gathering, z, y0, count, summed, total)
            volume[z, y0 : y0 + count] = total[:count, :nx]


@njit(cache=True, error_model="numpy")
def gather_rows(
    projections: FloatArray, gathering: Gathering, z: int, y0: int, count: int, summed: FloatArray, total: FloatArray
) -> None:
    """total[r] = what the transpose of ``project_view`` gives to voxel row y0 + r of slice z, summed over views.

    projections: float32 (views, ny, nx). summed: scratch, float32 (ROWS, pad + nx + pad), zero in its padding.
    total: float32 (ROWS, width); rows from ``count`` on have no meaning.
    """
    order, group_start, offsets, steps, pad, _ = gathering
    _, detector_rows, columns = projections.shape
    total[:] = np.float32(0.0)
    for group in range(len(group_start) - 1):
        empty = True
        for r in range(count):
            row = summed[r, pad : pad + columns]
            row[:] = np.float32(0.0)
            for k in order[group_start[group] : group_start[group + 1]]:
                offset, step = offsets[k, z, 0], steps[k, z, 0]
                # Detector rows j whose rays cross the slice less than one voxel row away.
                j = max(int(np.ceil((y0 + r - 1.0 - offset) / step)), 0)
                last = min(int(np.floor((y0 + r + 1.0 - offset) / step)), detector_rows - 1)
                while j <= last:
                    following = min(j + 1, last)
                    lower = _hat(offset + j * step - (y0 + r))
                    upper = _hat(offset + following * step - (y0 + r)) if following > j else 0.0
                    view = projections[k]
                    add_two_rows(view[j], view[following], np.float32(lower), np.float32(upper), row)
                    empty = False
                    j += 2
        if not empty:
            k = order[group_start[group]]
            reach = 1.0 / steps[k, z, 1]
            add_resampled_rows(summed, pad, -offsets[k, z, 1] * reach, reach, reach, total)


@njit(cache=True, error_model="numpy")
def _hat(distance: float) -> float:
    return max(0.0, 1.0 - abs(distance))


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def set_two_rows(
    first: FloatArray, second: FloatArray, lower: np.float32, upper: np.float32, total: FloatArray
) -> None:
    """total = lower first + upper second; all (n,)"""
    for i in range(len(total)):
        total[i] = lower * first[i] + upper * second[i]
