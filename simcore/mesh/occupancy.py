"""Share of body in blocks of voxels: the label volume at the resolution of the outline."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange


@njit(cache=True, parallel=True, nogil=True)
def _count_body(labels: Any, block_z: int, block_y: int, block_x: int, counts: Any) -> None:
    """counts[k, j, i] = voxels of block [k, j, i] that are not air."""
    nz, ny, nx = labels.shape
    for k in prange(counts.shape[0]):
        for z in range(k * block_z, min((k + 1) * block_z, nz)):
            for y in range(ny):
                j = y // block_y
                for i in range(counts.shape[2]):
                    body = 0
                    for x in range(i * block_x, min((i + 1) * block_x, nx)):
                        body += labels[z, y, x] != 0
                    counts[k, j, i] += body


def block_occupancy(labels: NDArray[np.uint8], block: tuple[int, int, int]) -> NDArray[np.float32]:
    """Fraction of every block of voxels that is not air.

    labels: uint8 (nz, ny, nx), read along x, at most a view of a contiguous array.
    block: voxels of a block along (z, y, x); what a block lacks at the far ends counts as air.
    returns: float32, each axis divided by its block and rounded up, values 0 to 1.
    """
    shape = tuple(-(-n // b) for n, b in zip(labels.shape, block, strict=True))
    counts = np.zeros(shape, dtype=np.int32)
    _count_body(labels, *block, counts)
    return (counts / np.prod(block)).astype(np.float32)
