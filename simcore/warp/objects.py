"""Lesions of few voxels, as objects: connected voxels of one tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.tissues import Tissue
from simcore.kernels import njit, prange

Indices = NDArray[np.int64]

LARGEST = {Tissue.MASS: 27, Tissue.CALCIFICATION: 500}
"""Voxels of the largest object that is looked after, by tissue; pieces of other tissues are parts of a texture. The
lookup keeps larger calcifications within 5 % of their volume, and masses well enough: what lies beneath a voxel of a
lesion is not known, and a breast with and without a mass is to differ in the mass alone."""
LARGEST_BOX = 64**3
"""Voxels of the box of the largest one; what is longer is no small object."""
TOLERANCE = 0.1
"""Relative difference of volume that a small object may have; of half a voxel where that is more."""


@dataclass(frozen=True, eq=False)
class Objects:
    """Connected voxels (26 neighbours) of one tissue each.

    tissue: uint8 (c,). start: int64 (c + 1,); voxels: int64 (n,), flat indices into the labels, those of object c are
    voxels[start[c]:start[c + 1]], ascending. total: connected objects of every tissue, small or not {tissue: number}.
    """

    tissue: NDArray[np.uint8]
    start: Indices
    voxels: Indices
    total: dict[Tissue, int]

    @property
    def sizes(self) -> Indices:
        return np.diff(self.start)


def tolerance(volume: NDArray[np.float64]) -> NDArray[np.float64]:
    """Voxels by which objects of ``volume`` (c,) voxels may differ."""
    return np.maximum(TOLERANCE * volume, 0.5)


def small_objects(labels: NDArray[np.uint8], counts: Indices) -> Objects:
    """The small lesions of ``labels``, in the order in which they are placed: masses before calcifications, large
    before small.

    counts: voxels of every label.
    """
    tissues, sizes, voxels, total = [], [], [], {}
    for lesion, largest in LARGEST.items():
        if counts[lesion] == 0:
            continue
        flat, number = components(labels, lesion)
        each = np.bincount(number)
        total[lesion] = len(each)
        small = (each <= largest) & (_boxes(flat, number, labels.shape) <= LARGEST_BOX)
        order = np.argsort(-each[small], kind="stable")
        ranks = np.full(len(each), -1, np.int64)
        ranks[np.flatnonzero(small)[order]] = np.arange(len(order))
        rank = ranks[number]
        kept = np.flatnonzero(rank >= 0)
        voxels.append(flat[kept[np.argsort(rank[kept], kind="stable")]])
        sizes.append(each[small][order])
        tissues.append(np.full(len(order), lesion, np.uint8))
    empty = np.empty(0, np.int64)
    return Objects(
        np.concatenate([np.empty(0, np.uint8), *tissues]),
        np.concatenate([[0], np.cumsum(np.concatenate([empty, *sizes]))]).astype(np.int64),
        np.concatenate([empty, *voxels]),
        total,
    )


def _boxes(flat: Indices, number: Indices, shape: tuple[int, ...]) -> Indices:
    """Voxels of the box of each object."""
    places = np.stack(np.unravel_index(flat, shape))
    low = np.full((3, number.max(initial=-1) + 1), max(shape))
    high = np.zeros_like(low)
    for axis in range(3):
        np.minimum.at(low[axis], number, places[axis])
        np.maximum.at(high[axis], number, places[axis])
    return np.asarray((high - low + 1).prod(axis=0))


def components(labels: NDArray[np.uint8], tissue: int) -> tuple[Indices, Indices]:
    """(flat indices of the voxels of ``tissue``, ascending; number of the object of each, by its first voxel)

    For lesions, which are few voxels of many: simcore.core.components, which is made for whole bodies, takes two to
    four times as long to find them; this one takes 24 bytes a voxel of the tissue.
    """
    flat = _places(labels, np.uint8(tissue))
    first, _ = joined(flat, np.zeros_like(flat), np.array(labels.shape), 1)
    return flat, (np.cumsum(first == np.arange(len(flat))) - 1)[first]


@njit(parallel=True, cache=True)
def _places(labels: NDArray[np.uint8], tissue: np.uint8) -> Indices:
    nz, ny, nx = labels.shape
    start = np.zeros(nz + 1, np.int64)
    for k in prange(nz):
        count = 0
        for j in range(ny):
            for i in range(nx):
                count += labels[k, j, i] == tissue
        start[k + 1] = count
    start = np.cumsum(start)
    places = np.empty(start[nz], np.int64)
    for k in prange(nz):
        at = start[k]
        if start[k + 1] > at:
            for j in range(ny):
                for i in range(nx):
                    if labels[k, j, i] == tissue:
                        places[at] = (k * ny + j) * nx + i
                        at += 1
    return places


@njit(cache=True)
def joined(flat: Indices, owner: Indices, shape: Indices, count: int) -> tuple[Indices, NDArray[np.bool_]]:
    """Pieces of voxels (n,) of an array of ``shape``: neighbours (26) with the same owner belong together.

    flat: ascending. owner: -1..count - 1.
    returns: the first voxel (its place in ``flat``) of the piece of each; (count,) whether an owner has a voxel next to
        one of a lower owner.
    """
    ny, nx = shape[1], shape[2]
    root = np.arange(len(flat))
    touching = np.zeros(count, np.bool_)
    cursor = np.zeros(13, np.int64)  # neighbours in the same direction follow one another
    for n in range(len(flat)):
        k, j, i = flat[n] // (ny * nx), flat[n] // nx % ny, flat[n] % nx
        for step in range(13):  # the neighbours that come before
            dk, dj, di = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
            if k + dk < 0 or not 0 <= j + dj < ny or not 0 <= i + di < nx:
                continue
            other = flat[n] + (dk * ny + dj) * nx + di
            at = cursor[step]
            while flat[at] < other:
                at += 1
            cursor[step] = at
            if flat[at] != other:
                continue
            if owner[at] == owner[n]:
                a, b = _top(root, n), _top(root, at)
                root[max(a, b)] = min(a, b)
            else:
                touching[max(owner[at], owner[n])] = True
    for n in range(len(flat)):
        root[n] = _top(root, n)
    return root, touching


@njit(cache=True)
def _top(root: Indices, n: int) -> int:
    while root[n] != n:
        root[n] = root[root[n]]
        n = root[n]
    return n


def erase(labels: NDArray[np.uint8], voxels: Indices) -> None:
    """Puts the tissue around them in the place of ``voxels`` (flat indices)."""
    _fill(labels, voxels)


@njit(cache=True)
def _fill(labels: NDArray[np.uint8], voxels: Indices) -> None:
    """From the rim inwards: what most of the six neighbours are that are known; air only where all are."""
    nz, ny, nx = labels.shape
    unknown = np.uint8(255)
    for place in voxels:
        labels[place // (ny * nx), place // nx % ny, place % nx] = unknown
    left = voxels.copy()
    while len(left):
        fresh = np.full(len(left), unknown, np.uint8)
        for n, place in enumerate(left):
            k, j, i = place // (ny * nx), place // nx % ny, place % nx
            votes = np.zeros(256, np.int64)
            for axis in range(3):
                for step in (-1, 1):
                    c, b, a = k + step * (axis == 0), j + step * (axis == 1), i + step * (axis == 2)
                    if 0 <= c < nz and 0 <= b < ny and 0 <= a < nx:
                        votes[labels[c, b, a]] += 1
            if votes[1:255].sum() > 0:
                fresh[n] = 1 + np.argmax(votes[1:255])
            elif votes[255] == 0:
                fresh[n] = 0
        if (fresh == unknown).all():
            fresh[:] = 0
        for n, place in enumerate(left):
            labels[place // (ny * nx), place // nx % ny, place % nx] = fresh[n]
        left = left[fresh == unknown]
