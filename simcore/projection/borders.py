"""Where tissue changes along x: what a row of voxels amounts to, in a twentieth of its entries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import frozen
from simcore.core.tissues import MAX_TISSUES
from simcore.kernels import njit, prange
from simcore.simd.vector import word_at

PLACE_SHIFT = 8
"""A border is one number: its place, then the labels before and after it, four bits each."""
assert MAX_TISSUES == 16


@dataclass(frozen=True)
class Borders:
    """The borders of all rows of voxels, row after row.

    start:  int64 (nz * ny + 1,), those of row (k, j) are start[k * ny + j] .. start[k * ny + j + 1].
    packed: uint32, x index of the voxel behind the border << 8 | label before << 4 | label behind; ascending within a
            row. Beside the volume is air.
    shape:  (nz, ny, nx) of the labels.
    """

    start: NDArray[np.int64]
    packed: NDArray[np.uint32]
    shape: tuple[int, int, int]

    def present(self, mu: NDArray[np.float64]) -> NDArray[np.float64]:
        """The table of coefficients with 0 for tissues that no voxel has: kernels spend time on each that is not 0."""
        return np.where(_labels_in(self.packed) >> np.arange(MAX_TISSUES) & 1, mu, 0.0)

    def row_ends(self, mu: NDArray[np.float64]) -> NDArray[np.int32]:
        """(nz, ny): one more than the last x index with mu > 0 in every row of voxels, 0 where there is none."""
        ends: NDArray[np.int32] = _row_ends(self.start, self.packed, mu)
        return ends.reshape(self.shape[:2])

    def falls(self, mu: NDArray[np.float64]) -> NDArray[np.float32]:
        """By how much mu falls at a border, by the lower eight bits of its number, float32 (256,)."""
        return np.asarray(np.subtract.outer(mu, mu).ravel(), np.float32)


def borders_of(labels: NDArray[np.uint8]) -> Borders:
    """labels: uint8 (nz, ny, nx), below MAX_TISSUES. Four bytes a border: a breast has 14 a row of voxels."""
    nz, ny, _ = labels.shape
    start = np.zeros(nz * ny + 1, np.int64)
    _count(labels, start)
    np.cumsum(start, out=start)
    packed = np.empty(start[-1], np.uint32)
    _fill(labels, start, packed)
    return Borders(frozen(start), frozen(packed), labels.shape)  # type: ignore[arg-type]


@njit(parallel=True, cache=True)
def _count(labels: NDArray[np.uint8], start: NDArray[np.int64]) -> None:
    nz, ny, nx = labels.shape
    for k in prange(nz):
        for j in range(ny):
            row = labels[k, j]
            total = np.int64(row[0] != 0) + np.int64(row[nx - 1] != 0)
            for i in range(1, nx):
                total += row[i] != row[i - 1]
            start[k * ny + j + 1] = total


@njit(parallel=True, cache=True)
def _fill(labels: NDArray[np.uint8], start: NDArray[np.int64], packed: NDArray[np.uint32]) -> None:
    nz, ny, nx = labels.shape
    for k in prange(nz):
        for j in range(ny):
            row = labels[k, j]
            at = start[k * ny + j]
            if row[0] != 0:
                packed[at] = row[0]
                at += 1
            i = 1
            while at < start[k * ny + j + 1]:
                while i + 8 <= nx and word_at(row, i) == word_at(row, i - 1):
                    i += 8
                stop = min(i + 8, nx)
                while i < stop:
                    if row[i] != row[i - 1]:
                        packed[at] = i << PLACE_SHIFT | np.int64(row[i - 1]) << 4 | np.int64(row[i])
                        at += 1
                    i += 1
                if stop == nx and row[nx - 1] != 0:
                    packed[at] = nx << PLACE_SHIFT | np.int64(row[nx - 1]) << 4
                    at += 1


@njit(cache=True)
def _labels_in(packed: NDArray[np.uint32]) -> int:
    """Bit n is set where a border has label n on either side."""
    bits = np.int64(0)
    for border in packed:
        bits |= 1 << np.int64(border & 15) | 1 << np.int64(border >> 4 & 15)
    return int(bits)


@njit(parallel=True, cache=True)
def _row_ends(start: NDArray[np.int64], packed: NDArray[np.uint32], mu: NDArray[np.float64]) -> NDArray[np.int32]:
    ends = np.zeros(len(start) - 1, np.int32)
    for row in prange(len(ends)):
        for border in range(start[row + 1] - 1, start[row] - 1, -1):
            if mu[packed[border] >> np.uint32(4) & np.uint32(15)] > 0.0:
                ends[row] = packed[border] >> np.uint32(PLACE_SHIFT)
                break
    return ends
