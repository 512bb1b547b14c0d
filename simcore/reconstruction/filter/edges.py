"""The slow variation of the breast's thickness, taken out of projections before they are filtered.

The ramp turns the outline of the breast, where centimetres of tissue end at once, into strong bands that
the back-projection carries into every slice. What does it is smooth: the mean attenuation of the periphery against
that of the part that both plates touch. So from each line integral the smooth part is taken, as far as it does not
exceed a value that most of the breast has: inside, the line integral less a constant is left, and towards the skin
the structure about a falling thickness. (The idea is that of the peripheral equalisation of mammograms, U. Bick
and others, Acad. Radiol. 3 (1996) 918.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simcore.core.artifacts import ProjectionStack
from simcore.core.geometry import AcquisitionGeometry
from simcore.reconstruction.filter.filters import chord_weights
from simcore.reconstruction.filter.line_integrals import line_integrals

FloatArray = NDArray[np.float32]
CELL_MM = 2.0
"""Cells that line integrals are averaged over; finer structure stays in the projections."""
LEAST = 0.05
"""Line integrals below this count as outside of the breast."""
QUANTILE = 0.25
"""Part of the breast's area that counts as periphery."""
COLUMNS = 256


@dataclass(frozen=True)
class Profile:
    """The smooth part of a view, in cells.

    values: float32 (rows, columns) of cells, line integrals as of rays perpendicular to the slices.
    filled: float32, the same shape: 1 in cells that lie within the breast with their neighbours, less at its edge.
    cell: pixels along a cell's edge.
    """

    values: FloatArray
    filled: FloatArray
    cell: int
    geometry: AcquisitionGeometry
    view: int

    def take_from(self, integrals: FloatArray, columns: slice) -> None:
        """Subtract it from line integrals of some columns, float32 (ny, columns), within the breast."""
        rows, columns_of_cells = self.values.shape
        along_x = _positions(np.arange(columns.start, columns.stop), self.cell, columns_of_cells)
        along_y = _positions(np.arange(integrals.shape[0]), self.cell, rows)
        smooth, filled = (
            _interpolated(_interpolated(cells, *along_x, axis=1), *along_y, axis=0)
            for cells in (self.values, self.filled)
        )
        smooth /= chord_weights(self.geometry, self.view, columns, 1.0)
        # At the very edge a cell's mean exceeds the thinnest parts in it: nothing there becomes negative.
        smooth = np.where(filled < 0.99, np.minimum(smooth, integrals), smooth)
        integrals -= np.where(integrals > LEAST, smooth, integrals)


def thickness_profile(stack: ProjectionStack, view: int, columns: int) -> Profile:
    """The smooth part of a view, cut off at a low quantile of its values over the breast.

    columns: of the detector that hold signal.
    """
    detector = stack.geometry.detector
    cell = max(1, round(CELL_MM / detector.pixel))
    shape = (-(-detector.ny // cell), -(-columns // cell))
    total, count = np.zeros(shape), np.zeros(shape)
    row_starts = np.arange(0, detector.ny, cell)
    for start in range(0, columns, COLUMNS * cell):
        block = slice(start, min(start + COLUMNS * cell, columns))
        integrals = line_integrals(stack, view, block)
        inside = integrals > LEAST
        upright = np.where(inside, integrals * chord_weights(stack.geometry, view, block, 1.0), 0.0)
        cells = slice(start // cell, -(-block.stop // cell))
        column_starts = np.arange(0, block.stop - start, cell)
        for values, sums in ((upright, total), (inside.astype(np.float64), count)):
            by_row = np.add.reduceat(values, row_starts, axis=0, dtype=np.float64)
            sums[:, cells] = np.add.reduceat(by_row, column_starts, axis=1)
    smooth, weight = np.zeros(shape), gaussian_filter(count, 1.0)
    np.divide(gaussian_filter(total, 1.0), weight, out=smooth, where=weight > 0)
    filled = weight / cell**2
    inside_cells = smooth[count == cell**2]
    if len(inside_cells):
        np.minimum(smooth, np.quantile(inside_cells, QUANTILE), out=smooth)
    return Profile(smooth.astype(np.float32), filled.astype(np.float32), cell, stack.geometry, view)


def _positions(pixels: NDArray[np.int64], cell: int, cells: int) -> tuple[NDArray[np.int64], FloatArray]:
    """(lower cell, weight of the next one) of pixel centres; constant beyond the centres of the outer cells."""
    position = np.clip((pixels + 0.5) / cell - 0.5, 0, cells - 1)
    lower = np.minimum(position.astype(np.int64), max(cells - 2, 0))
    return lower, (position - lower).astype(np.float32)


def _interpolated(values: FloatArray, lower: NDArray[np.int64], weight: FloatArray, axis: int) -> FloatArray:
    upper = np.minimum(lower + 1, values.shape[axis] - 1)
    shaped = weight[None, :] if axis == 1 else weight[:, None]
    return np.asarray((1 - shaped) * values.take(lower, axis) + shaped * values.take(upper, axis))
