"""Total variation denoising of slices.

Within a slice alone: a tomosynthesis volume knows little of depth, and slices then need no memory but their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange

FloatArray = NDArray[np.float32]
STEP = 0.248
"""Of the projected gradient; it converges up to 1/4 (J.-F. Aujol, J. Math. Imaging Vis. 34 (2009) 307)."""


def denoise_slices(volume: FloatArray, strength: float, steps: int) -> None:
    """Every slice becomes argmin over u of 1/2 |u - slice|^2 + strength TV(u), in place, as far as ``steps`` go.

    A. Chambolle, "An algorithm for total variation minimization and applications", J. Math. Imaging Vis. 20 (2004) 89.

    volume: float32 (nz, ny, nx). strength: in units of the volume, for gradients per pixel.
    """
    _denoise_slices(volume, np.float32(strength), steps)


@njit(cache=True, parallel=True, error_model="numpy")
def _denoise_slices(volume: FloatArray, strength: np.float32, steps: int) -> None:
    nz, ny, nx = volume.shape
    for z in prange(nz):
        along_y, along_x = np.zeros((ny, nx), np.float32), np.zeros((ny, nx), np.float32)
        sought = np.empty((ny, nx), np.float32)
        for _ in range(steps):
            for y in range(ny):
                _set_sought(volume[z, y], along_y, along_x, y, strength, sought[y])
            for y in range(ny):
                _step(sought[y], sought[min(y + 1, ny - 1)], strength, along_y[y], along_x[y])
        for y in range(ny):
            _set_sought(volume[z, y], along_y, along_x, y, strength, sought[y])
        volume[z] = sought


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _set_sought(
    row: FloatArray, along_y: FloatArray, along_x: FloatArray, y: int, strength: np.float32, sought: FloatArray
) -> None:
    """sought = row + strength x divergence of the dual field in row y (no flow through the border of the slice).

    The field's last row and column stay zero, for forward differences vanish there."""
    nx = len(row)
    if y > 0:
        for x in range(nx):
            sought[x] = row[x] + strength * (along_y[y, x] - along_y[y - 1, x])
    else:
        for x in range(nx):
            sought[x] = row[x] + strength * along_y[y, x]
    sought[0] += strength * along_x[y, 0]
    for x in range(1, nx):
        sought[x] += strength * (along_x[y, x] - along_x[y, x - 1])


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _step(
    row: FloatArray, following: FloatArray, strength: np.float32, along_y: FloatArray, along_x: FloatArray
) -> None:
    """A step of the dual field along the gradient of what is sought, then back to lengths of at most one."""
    nx = len(row)
    factor = np.float32(STEP) / strength
    for x in range(nx):
        right = row[x + 1] - row[x] if x + 1 < nx else np.float32(0.0)
        down = along_y[x] + factor * (following[x] - row[x])
        across = along_x[x] + factor * right
        length = max(np.float32(1.0), np.sqrt(down * down + across * across))
        along_y[x] = down / length
        along_x[x] = across / length
