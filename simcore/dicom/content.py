"""What tells the content of arrays apart."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit

_LANES = 8
_ODD = np.uint64(0x9E3779B97F4A7C15)


def array_digest(array: NDArray[Any]) -> str:
    """Hexadecimal digest of the type, shape and content of an array; plane by plane, so a memory map is streamed.

    array: (planes, ...), of any type.
    It tells arrays apart that were not made to look alike, at the speed of memory: a plane is reduced to 64 bytes, and
    only these go through sha256.
    """
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    for plane in array:
        content = np.ascontiguousarray(plane).reshape(-1).view(np.uint8)
        whole = len(content) // (8 * _LANES) * (8 * _LANES)
        digest.update(_mixed(content[:whole].view(np.uint64).reshape(-1, _LANES)).tobytes())
        digest.update(content[whole:].tobytes())
    return digest.hexdigest()


@njit(cache=True, nogil=True)
def _mixed(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """One word a column, uint64 (_LANES,), of uint64 (n, _LANES): each step is one to one, so a word that differs alone
    is always seen."""
    lanes = np.zeros(_LANES, np.uint64)
    for k in range(len(words)):
        for lane in range(_LANES):
            mixed = (lanes[lane] ^ words[k, lane]) * _ODD
            lanes[lane] = mixed ^ (mixed >> np.uint64(29))
    return lanes
