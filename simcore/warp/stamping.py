"""Small objects put into the compressed labels, one after the other, each apart from its neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.kernels import njit
from simcore.warp.objects import Indices, Objects, tolerance
from simcore.warp.points import Floats, ForwardMap

SAMPLES = 4
"""Samples along the edge of a voxel: 64 tell how much of each voxel of the output it covers."""
CALCIFICATION = np.uint8(Tissue.CALCIFICATION)
APART, TOUCHING, ANYWHERE = range(3)
AWAY = 3
"""An object is moved by so many voxels at most to keep it apart from another one."""


def stamp(
    objects: Objects,
    which: NDArray[np.bool_],
    volume: Floats,
    points: Floats,
    tets: Indices,
    spacing: Floats,
    forward: ForwardMap,
    out: NDArray[np.uint8],
    grid: Grid,
) -> tuple[Indices, NDArray[np.bool_]]:
    """Writes the objects ``which`` (c,) into ``out``, uint8 (nz, ny, nx) on ``grid``.

    volume: (c,) that they have there, voxels. points, tets: centre, mm, and tetrahedron of each of their voxels, whose
    edges are ``spacing``.
    returns: of every object the voxels it got, and whether it had to touch another one.
    """
    edge = np.array(grid.spacing)
    centres = (forward.moved(points, tets) - np.array(grid.corner)) / edge
    # d place in the output / d place in the source, both in voxels
    steps = np.einsum("pna,pnb->pab", forward.deformed[tets], forward.weights[tets][:, :, 1:])
    steps = steps * spacing / edge[:, None]
    most = np.maximum(np.rint(volume), 1).astype(np.int64)
    least = np.maximum(np.ceil(volume - tolerance(volume)), 1).astype(np.int64)
    filled, merged = np.zeros_like(most), np.zeros(len(most), np.bool_)
    _stamp(
        np.flatnonzero(which), objects.tissue, objects.start, least, most, centres, np.ascontiguousarray(steps),
        out, filled, merged,
    )  # fmt: skip
    return filled, merged


@njit(cache=True, error_model="numpy")
def _stamp(
    which: Indices,
    tissue: NDArray[np.uint8],
    start: Indices,
    least: Indices,
    most: Indices,
    centres: Floats,
    steps: Floats,
    out: NDArray[np.uint8],
    filled: Indices,
    merged: NDArray[np.bool_],
) -> None:
    """Apart from others where there is room for ``least`` voxels of an object, else touching them."""
    for c in which:
        first, stop = start[c], start[c + 1]
        corner, cover = _cover(centres[first:stop], steps[first:stop])
        middle = np.empty(3)
        for axis in range(3):
            middle[axis] = centres[first:stop, axis].mean() - corner[axis] - 0.5
        reached = np.ones(cover.shape, np.bool_)
        for room in (APART, TOUCHING, ANYWHERE):
            if filled[c] >= least[c] or (room == ANYWHERE and filled[c] > 0):
                break
            merged[c] = room != APART
            free = _free(out, corner, cover.shape, tissue[c], room)
            filled[c] = _grow(cover, middle, free, reached, filled[c], most[c], out, corner, tissue[c])


@njit(cache=True, error_model="numpy")
def _cover(centres: Floats, steps: Floats) -> tuple[Indices, Indices]:
    """(first voxel (x, y, z) of a box about an object, samples of the object in each voxel of the box (z, y, x))"""
    corner, far = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        low, high = np.inf, -np.inf
        for p in range(len(centres)):
            reach = 0.5 * np.abs(steps[p, axis]).sum()
            low, high = min(low, centres[p, axis] - reach), max(high, centres[p, axis] + reach)
        corner[axis], far[axis] = np.int64(np.floor(low)) - AWAY, np.int64(np.floor(high)) + AWAY
    cover = np.zeros((far[2] - corner[2] + 1, far[1] - corner[1] + 1, far[0] - corner[0] + 1), np.int64)
    for p in range(len(centres)):
        for sample in range(SAMPLES**3):
            dx = (sample % SAMPLES + 0.5) / SAMPLES - 0.5
            dy = (sample // SAMPLES % SAMPLES + 0.5) / SAMPLES - 0.5
            dz = (sample // SAMPLES**2 + 0.5) / SAMPLES - 0.5
            x = centres[p, 0] + steps[p, 0, 0] * dx + steps[p, 0, 1] * dy + steps[p, 0, 2] * dz
            y = centres[p, 1] + steps[p, 1, 0] * dx + steps[p, 1, 1] * dy + steps[p, 1, 2] * dz
            z = centres[p, 2] + steps[p, 2, 0] * dx + steps[p, 2, 1] * dy + steps[p, 2, 2] * dz
            i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            cover[k - corner[2], j - corner[1], i - corner[0]] += 1
    return corner, cover


@njit(cache=True)
def _free(
    out: NDArray[np.uint8], corner: Indices, shape: tuple[int, int, int], tissue: np.uint8, room: int
) -> NDArray[np.bool_]:
    """Where in a box an object of ``tissue`` may lie: neither in a calcification nor in its own tissue; but with
    ANYWHERE inside of the body; APART: not next to its own tissue."""
    nz, ny, nx = out.shape
    free = np.zeros(shape, np.bool_)
    for k in range(shape[0]):
        for j in range(shape[1]):
            for i in range(shape[2]):
                z, y, x = k + corner[2], j + corner[1], i + corner[0]
                if not (0 <= z < nz and 0 <= y < ny and 0 <= x < nx):
                    continue
                label = out[z, y, x]
                if label in (CALCIFICATION, tissue) or (label == 0 and room != ANYWHERE):
                    continue
                free[k, j, i] = room != APART or not _touches(out, z, y, x, tissue)
    return free


@njit(cache=True)
def _touches(out: NDArray[np.uint8], z: int, y: int, x: int, tissue: np.uint8) -> bool:
    nz, ny, nx = out.shape
    for c in range(max(z - 1, 0), min(z + 2, nz)):
        for b in range(max(y - 1, 0), min(y + 2, ny)):
            for a in range(max(x - 1, 0), min(x + 2, nx)):
                if out[c, b, a] == tissue:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _grow(
    cover: Indices,
    middle: Floats,
    free: NDArray[np.bool_],
    reached: NDArray[np.bool_],
    filled: int,
    most: int,
    out: NDArray[np.uint8],
    corner: Indices,
    tissue: np.uint8,
) -> int:
    """Takes voxels one by one, each next to one that is taken (26 neighbours; ``reached``): of those that are free the
    one that the object covers most, then the one nearest to its middle. Returns how many of ``most`` are filled."""
    nz, ny, nx = cover.shape
    for number in range(filled, most):
        best, covered, near = -1, -1, np.inf
        for k in range(nz):
            for j in range(ny):
                for i in range(nx):
                    if not (free[k, j, i] and reached[k, j, i]) or cover[k, j, i] < covered:
                        continue
                    away = (i - middle[0]) ** 2 + (j - middle[1]) ** 2 + (k - middle[2]) ** 2
                    if cover[k, j, i] > covered or away < near:
                        best, covered, near = (k * ny + j) * nx + i, cover[k, j, i], away
        if best < 0:
            return number
        if number == 0:
            reached[:] = False
        k, j, i = best // (ny * nx), best // nx % ny, best % nx
        free[k, j, i] = False
        out[k + corner[2], j + corner[1], i + corner[0]] = tissue
        reached[max(k - 1, 0) : k + 2, max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2] = True
    return most
