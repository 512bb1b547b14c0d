"""Memory that begins on a cache line, so that no vector of a line's length lies across two."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit

Singles = NDArray[np.float32]

LINE_BYTES = 64
_LINE = LINE_BYTES // 4


def empty(*shape: int) -> Singles:
    """float32 of this shape, C order, for callers of kernels."""
    room: Singles = row(int(np.prod(shape)))
    return room.reshape(shape)


@njit(cache=True, nogil=True)
def row(count: int) -> Singles:
    """float32 (count,), not set, for kernels."""
    room = np.empty(count + _LINE, np.float32)
    start = -room.ctypes.data % LINE_BYTES // 4
    part: Singles = room[start : start + count]
    return part


@njit(cache=True, nogil=True)
def zeros(count: int) -> Singles:
    """float32 (count,), for kernels."""
    room: Singles = row(count)
    room[:] = np.float32(0.0)
    return room
