"""Siddon's sum along one ray in double precision, written out plainly: what projectors are measured against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.grid import Grid


def siddon(
    labels: NDArray[np.uint8],
    grid: Grid,
    source: NDArray[np.float64],
    pixel: NDArray[np.float64],
    mu: NDArray[np.float64],
) -> float:
    """Integral of the attenuation from source to pixel, both (x, y, z), mm.

    R. L. Siddon, Med. Phys. 12 (1985) 252: all crossings of the ray with planes between voxels, in order; the voxel
    of each piece follows from its middle.
    """
    direction = pixel - source
    crossings = [np.array([0.0, 1.0])]
    for axis in range(3):
        planes = grid.corner[axis] + np.arange(grid.shape[2 - axis] + 1) * grid.spacing[axis]
        if direction[axis] != 0.0:
            crossings.append((planes - source[axis]) / direction[axis])
    part = np.unique(np.concatenate(crossings))
    part = part[(part >= 0.0) & (part <= 1.0)]
    middle = source + (part[1:] + part[:-1])[:, None] / 2 * direction
    index = np.floor((middle - grid.corner) / grid.spacing).astype(np.int64)
    inside = np.all((index >= 0) & (index < grid.shape[::-1]), axis=1)
    x, y, z = index[inside].T
    lengths = np.diff(part)[inside] * np.linalg.norm(direction)
    return float(mu[labels[z, y, x]] @ lengths)
