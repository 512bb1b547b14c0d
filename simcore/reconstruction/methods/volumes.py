"""From weighted projections to the stored volume."""

from __future__ import annotations

from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report, Volume
from simcore.core.grid import Grid
from simcore.core.progress import Progress
from simcore.reconstruction.kinds.common import VolumeSpec
from simcore.reconstruction.operators.backprojection import BackprojectionPlan, backproject_quantised
from simcore.reconstruction.operators.lanes import ROWS

FloatArray = NDArray[np.float32]
PARTS = 16
"""Progress is told about so often."""


def backprojected_volume(
    projections: FloatArray, plan: BackprojectionPlan, grid: Grid, spec: VolumeSpec, progress: Progress
) -> Volume:
    """The sum over views, as it is stored.

    projections: float32 (views, ny, columns), 1/mm.
    """
    data = np.empty(grid.shape, np.uint16)
    ny = grid.shape[1]
    step = ROWS * max(1, ceil(ny / ROWS / PARTS))
    low = high = 0
    for start in range(0, ny, step):
        rows = slice(start, min(start + step, ny))
        progress(start / ny, f"backprojecting row {start} of {ny}")
        clipped = backproject_quantised(projections, plan, rows, spec.value_slope, spec.value_intercept, data)
        low, high = low + clipped[0], high + clipped[1]
    progress(1.0, "reconstructed")
    return Volume(data, grid, spec.value_slope, spec.value_intercept, volume_report(grid, low, high))


def seen_columns(plan: BackprojectionPlan, grid: Grid) -> int:
    """How many detector columns voxels read, from the chest wall on."""
    last = plan.column_offset + (grid.shape[2] - 1) * plan.column_step
    return max(floor(float(last.max())) + 2, 0)


def volume_report(grid: Grid, clipped_low: int, clipped_high: int) -> Report:
    return {
        "slices": grid.shape[0],
        "slice_mm": grid.spacing[2],
        "pixel_mm": grid.spacing[0],
        "clipped_voxels": clipped_low + clipped_high,
        "clipped_low_voxels": clipped_low,
        "clipped_high_voxels": clipped_high,
    }
