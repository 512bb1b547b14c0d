"""Known lesions in the voxels of the reconstructed volume: which voxels each of them holds, and its box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.components import Components, Extents, slabs
from simcore.core.grid import Grid, Point
from simcore.core.tissues import Tissue

TISSUES = (Tissue.MASS, Tissue.CALCIFICATION)
"""Labels that make a lesion."""

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Lesion:
    """One lesion of the compressed breast.

    name:   its id in the truth of the phantom; the name of its tissue where the phantom names none (uploaded).
    tissue: mass or calcification (a cluster is one lesion).
    centre: (x, y, z), mm, detector frame; volume_mm3: of its voxels in the compressed phantom.
    voxels: int64 (n, 3) indices (z, y, x) of the voxels of the volume that it lies in, ordered; may be none where it
            lies beyond the volume.
    """

    name: str
    tissue: Tissue
    centre: Point
    volume_mm3: float
    voxels: Indices

    @property
    def first(self) -> tuple[int, int, int]:
        """Lowest index (z, y, x) of its box."""
        z, y, x = self.voxels.min(axis=0)
        return int(z), int(y), int(x)

    @property
    def last(self) -> tuple[int, int, int]:
        """Highest index (z, y, x) of its box."""
        z, y, x = self.voxels.max(axis=0)
        return int(z), int(y), int(x)

    @property
    def slices(self) -> list[int]:
        """Slices that it lies in."""
        return [int(k) for k in np.unique(self.voxels[:, 0])]

    def mask(self, k: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Its voxels in slice ``k`` of (rows, columns)."""
        mask = np.zeros(shape, np.bool_)
        _, y, x = self.voxels[self.voxels[:, 0] == k].T
        mask[y, x] = True
        return mask


def find_lesions(phantom: Phantom, lift: float, volume: Grid) -> tuple[Lesion, ...]:
    """The lesions of a compressed phantom, in the order of its truth.

    Voxels that touch belong to one lesion, that whose centre lies in or next to them; where there are several such
    centres, to the nearest as measured by the sizes of their lesions. A voxel of the volume counts where its centre
    lies in the lesion or where it holds the centre of one of the lesion's voxels: a calcification that is smaller than
    the distance of two slices is not lost.

    lift: height of the support frame in the detector frame, mm.
    """
    grid = phantom.grid.moved(z=lift)
    lesions = []
    for tissue in TISSUES:
        voxels, pieces, extents = _voxels_of(phantom.labels, tissue)
        if not len(voxels):
            continue
        points = _centres(grid, voxels)
        objects = _known(phantom.truth, tissue, lift)
        names = objects.names or [tissue.name.lower()]
        owner = _owners(objects, points, pieces, extents) if objects.names else np.zeros(len(voxels), np.int64)
        for name in dict.fromkeys(names):
            mine = np.isin(owner, [k for k, other in enumerate(names) if other == name])
            if mine.any():
                x, y, z = (float(c) for c in points[mine].mean(axis=0))
                inside = _in_volume(voxels[mine], points[mine], grid, volume)
                lesions.append(Lesion(name, tissue, (x, y, z), int(mine.sum()) * grid.voxel_volume, inside))
    return tuple(lesions)


@dataclass(frozen=True, eq=False)
class _Objects:
    """Known objects of a tissue: name of the lesion of each, centre and size (n, 3) (x, y, z), mm; size 1 where it is
    not known."""

    names: list[str]
    centres: NDArray[np.float64]
    sizes: NDArray[np.float64]

    def nearest(self, points: NDArray[np.float64], among: Indices) -> Indices:
        """Of the objects ``among`` (m,), that to each of the points (n, 3) by distance relative to its size."""
        if len(among) == 1:
            return np.broadcast_to(among, len(points))
        away = (points[:, None] - self.centres[among]) / self.sizes[among]
        nearest: Indices = among[np.argmin(np.linalg.norm(away, axis=2), axis=1)]
        return nearest


def _voxels_of(labels: NDArray[np.uint8], tissue: Tissue) -> tuple[Indices, Indices, Extents]:
    """Indices (z, y, x), ordered; the connected component of each; these components."""
    components = Components(corners=True)
    voxels, numbers = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for first, slab in slabs(labels):
        # Most phantoms hold nothing beyond the tissues of every breast, and a maximum is found at the speed of memory.
        if slab.max(initial=0) < tissue:
            components.skip(len(slab))
            continue
        mask = slab == np.uint8(tissue)
        of_slab = components.add(mask)
        voxels.append(np.argwhere(mask) + np.array([first, 0, 0]))
        numbers.append(of_slab[mask].astype(np.int64))
    extents = components.extents()
    return np.concatenate(voxels), extents.of[np.concatenate(numbers)], extents


def _known(truth: tuple[dict[str, Any], ...], tissue: Tissue, lift: float) -> _Objects:
    """Every known object of a tissue; clusters by their parts."""
    entries = [e for e in truth if e.get("tissue") == tissue.name.lower() and "centre_mm" in e and "parts" not in e]
    return _Objects(
        [str(e.get("part_of", e["id"])) for e in entries],
        np.array([e["centre_mm"] for e in entries], np.float64).reshape(-1, 3) + np.array([0.0, 0.0, lift]),
        np.array([e.get("size_mm", (1.0, 1.0, 1.0)) for e in entries], np.float64).reshape(-1, 3),
    )


def _owners(objects: _Objects, points: NDArray[np.float64], pieces: Indices, extents: Extents) -> Indices:
    """The object to which each voxel belongs. points: centres of the voxels; pieces: the component of each."""
    members = np.split(np.argsort(pieces, kind="stable"), np.cumsum(extents.voxels)[:-1])
    everyone = np.arange(len(objects.names))
    homes = _homes(objects.centres, points, members)
    owner = np.empty(len(points), np.int64)
    for piece, mine in enumerate(members):
        among = np.flatnonzero(homes == piece)
        if len(among):
            owner[mine] = objects.nearest(points[mine], among)
        else:  # it broke off, and goes to whom its middle is nearest
            owner[mine] = objects.nearest(points[mine].mean(axis=0, keepdims=True), everyone)
    return owner


def _homes(centres: NDArray[np.float64], points: NDArray[np.float64], members: list[Indices]) -> Indices:
    """For each centre, the component with the voxel nearest to it."""
    lows = np.array([points[mine].min(axis=0) for mine in members])
    highs = np.array([points[mine].max(axis=0) for mine in members])
    homes = np.empty(len(centres), np.int64)
    for k, centre in enumerate(centres):
        beside = np.linalg.norm(np.maximum(np.maximum(lows - centre, centre - highs), 0.0), axis=1)
        best = np.inf
        for piece in np.argsort(beside, kind="stable"):
            if beside[piece] >= best:
                break
            distance = float(np.min(np.linalg.norm(points[members[piece]] - centre, axis=1)))
            if distance < best:
                best, homes[k] = distance, piece
    return homes


def _centres(grid: Grid, voxels: Indices) -> NDArray[np.float64]:
    """Centres (x, y, z) of voxels (z, y, x), mm."""
    centres: NDArray[np.float64] = np.asarray(grid.corner) + (voxels[:, ::-1] + 0.5) * np.asarray(grid.spacing)
    return centres


def _in_volume(voxels: Indices, points: NDArray[np.float64], grid: Grid, volume: Grid) -> Indices:
    """Voxels of ``volume`` with their centre in ``voxels`` of ``grid``, or with the centre of one of these in them."""
    holding = np.floor((points - volume.corner) / volume.spacing).astype(np.int64)[:, ::-1]
    both = np.concatenate([holding, _inverse(voxels, grid, volume)])
    inside = np.all((both >= 0) & (both < volume.shape), axis=1)
    return np.unique(both[inside], axis=0)


def _inverse(voxels: Indices, grid: Grid, volume: Grid) -> Indices:
    """Voxels of ``volume`` whose centre lies in ``voxels``, looked up over the box about them."""
    first, last = voxels.min(axis=0), voxels.max(axis=0)
    mask = np.zeros(last - first + 1, np.bool_)
    mask[tuple((voxels - first).T)] = True
    sources, targets = [], []
    for axis, name in enumerate("zyx"):
        i = 2 - axis
        index = np.floor((volume.centres(name) - grid.corner[i]) / grid.spacing[i]).astype(np.int64) - first[axis]
        inside = np.flatnonzero((index >= 0) & (index < mask.shape[axis]))
        sources.append(index[inside])
        targets.append(inside)
    hits = np.argwhere(mask[np.ix_(*sources)])
    return np.stack([target[hits[:, axis]] for axis, target in enumerate(targets)], axis=1)
