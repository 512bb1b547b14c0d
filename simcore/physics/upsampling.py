"""From the means of coarse cells to pixels, so that the sums of the pixels are those of the cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def spread_over_pixels(cells: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Pixel means of a smooth function of which the means over coarse cells are known.

    cells: (rows, columns); shape: of the pixels that cover the same area, not fewer than the cells.
    returns: float32, shape. Along each axis the sum up to each edge is interpolated by a cubic spline whose differences
        are the pixels: exact for parabolas, and the mean of all pixels is that of all cells.
    """
    rows, columns = (_weights(n, m) for n, m in zip(cells.shape, shape, strict=True))
    return np.asarray(rows @ cells.astype(np.float64) @ columns.T, np.float32)


def _weights(cells: int, pixels: int) -> NDArray[np.float64]:
    """(pixels, cells), so that weights @ means of cells = means of pixels."""
    from scipy.interpolate import CubicSpline

    sums = np.concatenate([np.zeros((1, cells)), np.cumsum(np.eye(cells), axis=0)])
    spline = CubicSpline(np.arange(cells + 1), sums, axis=0)
    edges = np.linspace(0, cells, pixels + 1)
    return np.asarray(np.diff(spline(edges), axis=0) * (pixels / cells))
