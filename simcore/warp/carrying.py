"""No small lesion is lost, joined with another, or changes its volume.

A voxel of the output looks up one point; a calcification of one voxel, squeezed to less than a voxel between the
plates, lies between these points as often as not, and one that is widened is met twice. Objects that the lookup kept
whole, apart, and within TOLERANCE of their volume stay as they are, so that a breast with and without a lesion differs
in the lesion alone; the others are put where the forward map leads them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.warp.objects import Indices, Objects, components, erase, joined, small_objects, tolerance
from simcore.warp.points import Floats, ForwardMap
from simcore.warp.stamping import stamp


@dataclass(frozen=True, eq=False)
class Carried:
    """What became of small objects, bool (c,): placed by the forward map; merged: had to touch another one; lost: found
    no place."""

    objects: Objects
    placed: NDArray[np.bool_]
    merged: NDArray[np.bool_]
    lost: NDArray[np.bool_]


def carry(
    phantom: Phantom, counts: Indices, mesh: TetMesh, forward: ForwardMap, out: NDArray[np.uint8], grid: Grid
) -> Carried:
    """Mends, in ``out`` (nz, ny, nx) on ``grid``, what the lookup made of the small lesions of ``phantom``.

    counts: voxels of every label of ``phantom``. forward: of ``mesh``.
    """
    objects = small_objects(phantom.labels, counts)
    none = np.zeros(len(objects.tissue), np.bool_)
    if not len(objects.tissue):
        return Carried(objects, none, none, none)
    spacing = np.array(phantom.grid.spacing)
    points = np.array(phantom.grid.corner) + (_places(objects.voxels, phantom.grid) + 0.5) * spacing
    tets = forward.tets(points)
    volume = np.add.reduceat(forward.ratio[tets], objects.start[:-1])
    backward = ForwardMap.of(replace(mesh, nodes=forward.nodes), mesh.nodes)
    placed = none.copy()
    for tissue in np.unique(objects.tissue):
        mine = np.flatnonzero(objects.tissue == tissue)
        flat, _ = components(out, int(tissue))
        owner = _owners(flat, grid, mine, objects, points, phantom, backward)
        placed[mine] = ~_kept(flat, owner, np.array(out.shape), volume, mine)
        erase(out, flat[(owner >= 0) & placed[owner]])
    filled, merged = stamp(objects, placed, volume, points, tets, spacing, forward, out, grid)
    return Carried(objects, placed, merged, placed & (filled == 0))


def _places(flat: Indices, grid: Grid) -> Indices:
    """(x, y, z) indices of voxels."""
    return np.stack(np.unravel_index(flat, grid.shape), axis=1)[:, ::-1].astype(np.int64)


def _owners(
    flat: Indices,
    grid: Grid,
    mine: Indices,
    objects: Objects,
    points: Floats,
    phantom: Phantom,
    backward: ForwardMap,
) -> Indices:
    """The object that each voxel of the output was looked up in, -1 where it is a large one.

    flat: voxels of the output of the tissue whose objects are ``mine``. points: centres of all objects' voxels, mm.
    """
    centres = np.array(grid.corner) + (_places(flat, grid) + 0.5) * np.array(grid.spacing)
    origin = backward.moved(centres, backward.tets(centres))
    first, stop = objects.start[mine[0]], objects.start[mine[-1] + 1]
    number = np.repeat(mine, objects.sizes[mine])
    spacing = np.array(phantom.grid.spacing)
    index = np.floor((origin - phantom.grid.corner) / spacing).astype(np.int64)
    i, j, k = np.clip(index, 0, np.array(phantom.grid.shape[::-1]) - 1).T
    at = np.ravel_multi_index((k, j, i), phantom.grid.shape)
    order = np.argsort(objects.voxels[first:stop])
    ascending = objects.voxels[first:stop][order]
    place = np.asarray(np.minimum(np.searchsorted(ascending, at), len(ascending) - 1))
    owner = np.where(ascending[place] == at, number[order][place], -1)
    # A point on a face of its tetrahedron, or of its voxel, may be rounded to the other side.
    beside = np.flatnonzero((owner < 0) & (phantom.labels[k, j, i] != objects.tissue[mine[0]]))
    away, near = map(np.asarray, cKDTree(points[first:stop] / spacing).query(origin[beside] / spacing, p=np.inf))
    owner[beside[away < 1.0]] = number[near[away < 1.0]]
    return owner


def _kept(flat: Indices, owner: Indices, shape: Indices, volume: Floats, mine: Indices) -> NDArray[np.bool_]:
    """Which of the objects ``mine`` the lookup kept whole, apart and with their volume (voxels, of all objects)."""
    count = len(volume)
    voxels = np.bincount(owner[owner >= 0], minlength=count)
    first, touching = joined(flat, owner, shape, count)
    beginning = owner[first == np.arange(len(flat))]
    pieces = np.bincount(beginning[beginning >= 0], minlength=count)
    close = np.abs(voxels - volume) <= tolerance(volume)
    return np.asarray((close & (voxels > 0) & (pieces == 1) & ~touching)[mine])
