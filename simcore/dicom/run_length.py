"""RLE lossless of DICOM (PS3.5 annex G): each byte plane of a frame in a segment of its own, packed row by row."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit


@njit(cache=True, nogil=True)
def pack_row(row: NDArray[np.uint8], packed: NDArray[np.uint8]) -> int:
    """PackBits of one row; returns the number of bytes. Runs of three and more are replicated, the rest literal."""
    n = row.size
    i = 0
    size = 0
    while i < n:
        run = 1
        while i + run < n and run < 128 and row[i + run] == row[i]:
            run += 1
        if run >= 3 or (run == 2 and i + run == n):
            packed[size] = 257 - run
            packed[size + 1] = row[i]
            size += 2
            i += run
            continue
        start = i
        while i < n and i - start < 128:
            if i + 2 < n and row[i] == row[i + 1] and row[i] == row[i + 2]:
                break
            i += 1
        packed[size] = i - start - 1
        size += 1
        for k in range(start, i):
            packed[size] = row[k]
            size += 1
    return size


@njit(cache=True, nogil=True)
def _pack_plane(plane: NDArray[np.uint8], packed: NDArray[np.uint8]) -> int:
    """All rows of one byte plane, one behind another; returns the number of bytes."""
    row = np.empty(plane.shape[1], np.uint8)
    size = 0
    for j in range(plane.shape[0]):
        row[:] = plane[j]
        size += pack_row(row, packed[size:])
    return size


def packed_length(columns: int) -> int:
    """The most bytes that a row of so many pixels can take."""
    return columns + columns // 128 + 2


def run_length_frame(frame: NDArray[Any]) -> bytes:
    """A frame of unsigned integers (rows, columns) in RLE, of even length."""
    rows, columns = frame.shape
    width = frame.dtype.itemsize
    # The most significant byte comes first.
    planes = np.ascontiguousarray(frame, frame.dtype.newbyteorder("<")).view(np.uint8).reshape(rows, columns, width)
    packed = np.empty(rows * packed_length(columns), np.uint8)
    segments = []
    for k in reversed(range(width)):
        size = _pack_plane(planes[:, :, k], packed)
        segments.append(packed[:size].tobytes() + b"\0" * (size % 2))
    return header(segments) + b"".join(segments)


def header(segments: list[bytes]) -> bytes:
    """The 64 bytes before the segments: their number and where each begins."""
    starts = [64 + sum(map(len, segments[:k])) for k in range(len(segments))]
    return struct.pack("<16L", len(segments), *starts, *[0] * (15 - len(segments)))
