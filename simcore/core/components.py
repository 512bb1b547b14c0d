"""Connected components of a mask that comes slab by slab: nothing larger than a slab is held.

Made for bodies, which fill their slabs; the warp, which looks three times for a few voxels of each lesion, has a search
of its own (simcore.warp.objects) that is faster there and would hold several arrays of the size of a body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SLAB_VOXELS = 1 << 23
"""Voxels of a slab: its numbers take four bytes each."""

Indices = NDArray[np.int64]


def slabs(array: NDArray[np.uint8]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """(first plane, view of some planes) of an array (z, y, x), about SLAB_VOXELS at a time."""
    planes = max(1, SLAB_VOXELS // max(1, array[0].size)) if len(array) else 1
    for first in range(0, len(array), planes):
        yield first, array[first : first + planes]


@dataclass(frozen=True, eq=False)
class Extents:
    """The components in the order of their first voxels.

    of:     int64, the component of every provisional number; entry 0, beside the mask, is -1.
    voxels: int64 (n,), how many each has.
    first:  int64 (n, 3), lowest index (z, y, x) of its box; behind: one behind the highest.
    centre: float64 (n, 3), mean index (z, y, x); zero without ``centres``.
    """

    of: Indices
    voxels: Indices
    first: Indices
    behind: Indices
    centre: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.voxels)

    @property
    def largest(self) -> int:
        """The one with most voxels."""
        return int(self.voxels.argmax())


def _filled(any_of: NDArray[np.bool_] | np.bool_) -> slice:
    """From the first to the last that is true."""
    places = np.flatnonzero(any_of)
    return slice(int(places[0]), int(places[-1]) + 1) if len(places) else slice(0, 0)


class Components:
    """Slabs are added in their order. Voxels belong together where they share a face, or with ``corners`` also where
    they share an edge or a corner alone. The same slabs get the same provisional numbers again. centres: whether their
    means are asked for, which takes longer than all else where the mask is large.
    """

    def __init__(self, corners: bool = False, centres: bool = True) -> None:
        self._corners = corners
        self._centres = centres
        self._count = 0
        self._plane = 0
        self._edge: NDArray[np.int32] | None = None
        self._pairs: list[Indices] = []
        self._parts: list[tuple[Indices, Indices, Indices, NDArray[np.float64]]] = []

    def add(self, mask: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Provisional numbers of the voxels of a slab (z, y, x), 0 beside the mask."""
        from scipy.ndimage import label

        numbers = np.zeros(mask.shape, np.int32)
        rows, columns = _filled(np.any(mask, axis=(0, 2))), _filled(np.any(mask, axis=(0, 1)))
        part = mask[:, rows, columns]
        if part.size:
            structure = np.ones((3, 3, 3), np.bool_) if self._corners else None
            own = np.zeros(part.shape, np.int32)
            count = int(label(part, structure, output=own))
            self._measure(own, count, (self._plane, rows.start, columns.start))
            if self._count:
                own[part] += self._count
            numbers[:, rows, columns] = own
            if self._edge is not None:
                near = np.s_[max(0, rows.start - 1) : rows.stop + 1, max(0, columns.start - 1) : columns.stop + 1]
                self._join(self._edge[near], numbers[0][near])
            self._count += count
        self._edge = numbers[-1]
        self._plane += len(mask)
        return numbers

    def skip(self, planes: int) -> None:
        """A slab of so many planes without a voxel of the mask."""
        self._edge = None
        self._plane += planes

    def extents(self) -> Extents:
        """What was added so far."""
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import connected_components

        if not self._count:
            none = np.empty(0, np.int64)
            return Extents(np.array([-1]), none, none.reshape(0, 3), none.reshape(0, 3), np.empty((0, 3)))
        pairs = np.concatenate([np.empty((0, 2), np.int64), *self._pairs]) - 1
        ones = np.ones(len(pairs), np.int8)
        graph = csr_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(self._count, self._count))
        total, group = connected_components(graph, directed=False)
        _, begins, of = np.unique(group, return_index=True, return_inverse=True)
        of = np.argsort(np.argsort(begins))[of]
        voxels, first, behind, sums = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        counts = np.bincount(of, voxels, total).astype(np.int64)
        low = np.full((total, 3), np.iinfo(np.int64).max)
        high = np.zeros((total, 3), np.int64)
        np.minimum.at(low, of, first)
        np.maximum.at(high, of, behind)
        centre = np.stack([np.bincount(of, sums[:, axis], total) for axis in range(3)], axis=1) / counts[:, None]
        return Extents(np.concatenate([[-1], of]), counts, low, high, centre)

    def _measure(self, numbers: NDArray[np.int32], count: int, corner: tuple[int, int, int]) -> None:
        from scipy.ndimage import find_objects

        boxes = find_objects(numbers, count)
        first = np.array([[side.start for side in box] for box in boxes])
        behind = np.array([[side.stop for side in box] for box in boxes])
        if count == 1:  # a body in one piece, mostly: at the speed of memory
            voxels = np.array([np.count_nonzero(numbers)])
        else:
            voxels = np.bincount(numbers.ravel(), minlength=count + 1)[1:]
        sums = np.zeros((count, 3))
        if self._centres:
            places = np.nonzero(numbers)
            owner = numbers[places] - 1
            sums = np.stack([np.bincount(owner, along, count) for along in places], axis=1)
        lift = np.array(corner)
        self._parts.append((voxels, first + lift, behind + lift, sums + voxels[:, None] * lift))

    def _join(self, edge: NDArray[np.int32], plane: NDArray[np.int32]) -> None:
        """Pairs of numbers that touch across the border of two slabs."""
        if not edge.any():
            return
        steps = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)] if self._corners else [(0, 0)]
        rows, columns = plane.shape
        for dy, dx in steps:
            here = plane[max(dy, 0) : rows + min(dy, 0), max(dx, 0) : columns + min(dx, 0)]
            there = edge[max(-dy, 0) : rows + min(-dy, 0), max(-dx, 0) : columns + min(-dx, 0)]
            both = (here > 0) & (there > 0)
            keys = (there[both].astype(np.int64) << 32) | here[both]
            if len(keys):  # long runs of the same pair, mostly
                keys = np.unique(keys[np.concatenate([[True], keys[1:] != keys[:-1]])])
                self._pairs.append(np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1))
