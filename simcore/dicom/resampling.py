"""Tissue labels at the voxel centres of another grid, as frames in the RLE lossless encoding of DICOM.

One pass, slice by slice: sampling, run lengths and the tissues met; the sampled volume itself is never held.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.dicom.run_length import header, pack_row, packed_length
from simcore.kernels import njit, prange

BLOCK = 16
"""Rows that one thread samples one after the other."""


@dataclass(frozen=True)
class Lookup:
    """Nearest voxel of one axis: index of the source voxel for every target voxel, -1 outside the source.

    z, y, x: int64, one entry a target voxel along that axis.
    """

    z: NDArray[np.int64]
    y: NDArray[np.int64]
    x: NDArray[np.int64]


def nearest(source: Grid, target: Grid) -> Lookup:
    """The source voxel that holds the centre of each target voxel; both grids in one frame."""
    axes = []
    for axis in "zyx":
        i = "xyz".index(axis)
        count = source.shape[2 - i]
        index = np.floor((target.centres(axis) - source.corner[i]) / source.spacing[i]).astype(np.int64)
        axes.append(np.where((index >= 0) & (index < count), index, -1))
    return Lookup(*axes)


def sample(
    phantom: Phantom, lookup: Lookup, step: tuple[int, int, int] = (1, 1, 1), slices: slice | None = None
) -> NDArray[np.uint8]:
    """Labels at every ``step``-th (z, y, x) target voxel of some slices (all of them); air (0) outside the phantom."""
    rows = lookup.z if slices is None else lookup.z[slices]
    z, y, x = rows[:: step[0]], lookup.y[:: step[1]], lookup.x[:: step[2]]
    labels = phantom.labels[np.ix_(z, y, x)]
    inside = (z >= 0)[:, None, None] & (y >= 0)[:, None] & (x >= 0)
    return np.where(inside, labels, 0).astype(np.uint8)


@njit(cache=True, parallel=True)
def _encode_plane(
    labels: NDArray[np.uint8],
    y: NDArray[np.int64],
    x: NDArray[np.int64],
    packed: NDArray[np.uint8],
    sizes: NDArray[np.int64],
    met: NDArray[np.uint32],
) -> None:
    """Sample one plane (ny, nx) of labels and pack its rows: row j into packed[j, :sizes[j]], tissues as bits."""
    first, stop = 0, x.size
    while first < stop and x[first] < 0:
        first += 1
    while stop > first and x[stop - 1] < 0:
        stop -= 1
    for block in prange((y.size + BLOCK - 1) // BLOCK):
        row = np.zeros(x.size, np.uint8)
        for j in range(block * BLOCK, min((block + 1) * BLOCK, y.size)):
            if j > block * BLOCK and y[j] == y[j - 1]:
                # Pixels are smaller than voxels: rows come in runs of the same.
                packed[j, : sizes[j - 1]] = packed[j - 1, : sizes[j - 1]]
                sizes[j] = sizes[j - 1]
                met[j] |= met[j - 1]
                continue
            bits = np.uint32(0)
            if y[j] >= 0:
                source = labels[y[j]]
                for i in range(first, stop):
                    row[i] = source[x[i]]
                    bits |= np.uint32(1) << np.uint32(row[i])
            else:
                row[:] = 0
            met[j] |= bits
            sizes[j] = pack_row(row, packed[j])


@njit(cache=True)
def _join_rows(packed: NDArray[np.uint8], sizes: NDArray[np.int64], joined: NDArray[np.uint8]) -> None:
    start = 0
    for j in range(sizes.size):
        for i in range(sizes[j]):
            joined[start + i] = packed[j, i]
        start += sizes[j]


@dataclass(frozen=True)
class EncodedLabels:
    """Label frames, RLE-encoded, one a slice of the target grid; tissues: the label values met, air left out."""

    frames: tuple[bytes, ...]
    tissues: tuple[int, ...]


def encode_labels(phantom: Phantom, lookup: Lookup) -> EncodedLabels:
    """Sample the phantom on the target grid of ``lookup`` and encode every slice.

    Label values of 32 and above are not allowed (core.tissues.MAX_TISSUES is 16).
    """
    met = np.zeros(lookup.y.size, np.uint32)
    frames = tuple(_frames(phantom, lookup, met))
    bits = int(np.bitwise_or.reduce(met))
    return EncodedLabels(frames, tuple(value for value in range(1, 32) if bits >> value & 1))


def _frames(phantom: Phantom, lookup: Lookup, met: NDArray[np.uint32]) -> Iterator[bytes]:
    rows, columns = lookup.y.size, lookup.x.size
    packed = np.empty((rows, packed_length(columns)), np.uint8)
    sizes = np.empty(rows, np.int64)
    outside = np.full(rows, -1, np.int64)
    for k in lookup.z:
        _encode_plane(phantom.labels[max(k, 0)], lookup.y if k >= 0 else outside, lookup.x, packed, sizes, met)
        joined = np.empty(int(sizes.sum()), np.uint8)
        _join_rows(packed, sizes, joined)
        yield header([joined.tobytes()]) + joined.tobytes() + b"\0" * (joined.size % 2)
