"""Known lesions in the voxels of the reconstructed volume: which voxels each of them holds, and its box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simcore.core.artifacts import Phantom
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

    Voxels belong to the nearest known object of their tissue. A voxel of the volume counts where its centre lies in
    the lesion or where it holds the centre of one of the lesion's voxels: a calcification that is smaller than the
    distance of two slices is not lost.

    lift: height of the support frame in the detector frame, mm.
    """
    grid = phantom.grid.moved(z=lift)
    found = []
    for tissue in TISSUES:
        voxels = _voxels_of(phantom.labels, tissue)
        if not len(voxels):
            continue
        names, centres = _known(phantom.truth, tissue)
        points = _centres(grid, voxels)
        if names:
            owner = np.array(cKDTree(np.add(centres, (0.0, 0.0, lift))).query(points)[1])
        else:
            names, owner = [tissue.name.lower()], np.zeros(len(voxels), np.int64)
        for name in dict.fromkeys(names):
            mine = np.isin(owner, [k for k, other in enumerate(names) if other == name])
            if mine.any():
                x, y, z = (float(c) for c in points[mine].mean(axis=0))
                inside = _in_volume(voxels[mine], points[mine], grid, volume)
                found.append(Lesion(name, tissue, (x, y, z), int(mine.sum()) * grid.voxel_volume, inside))
    return tuple(found)


_NOWHERE = np.empty(0, np.int64)


def _voxels_of(labels: NDArray[np.uint8], tissue: Tissue) -> Indices:
    """Indices (z, y, x), ordered."""
    columns = labels.shape[2]
    found = []
    for k, plane in enumerate(labels):
        # Most phantoms hold nothing beyond the tissues of every breast, and a maximum is found at the speed of memory.
        flat = np.flatnonzero(plane == np.uint8(tissue)) if plane.max(initial=0) >= tissue else _NOWHERE
        found.append(np.stack([np.full(len(flat), k), flat // columns, flat % columns], axis=1))
    return np.concatenate(found).astype(np.int64)


def _known(truth: tuple[dict[str, Any], ...], tissue: Tissue) -> tuple[list[str], list[list[float]]]:
    """Name of its lesion and centre (x, y, z) of every known object of a tissue; clusters by their parts."""
    entries = [e for e in truth if e.get("tissue") == tissue.name.lower() and "centre_mm" in e and "parts" not in e]
    return [str(e.get("part_of", e["id"])) for e in entries], [list(e["centre_mm"]) for e in entries]


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
