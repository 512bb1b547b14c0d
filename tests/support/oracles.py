"""The cells in the plainest form: every seed at every point in float64, and region growing voxel by voxel."""

from __future__ import annotations

import heapq
import itertools

import numpy as np
from numpy.typing import NDArray

from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.phantom.cells import START, SXX, SXY, SXZ, SYY, SYZ, SZZ, X, Z

Float64 = NDArray[np.float64]


def delays(table: NDArray[np.float32], points: Float64) -> tuple[Float64, Float64]:
    """Delay (points, seeds) and half gradient (points, seeds, 3) of every seed at every point (x, y, z), mm."""
    t = table.astype(np.float64)
    metric = t[[SXX, SXY, SXZ, SXY, SYY, SYZ, SXZ, SYZ, SZZ]].reshape(3, 3, -1)
    offset = points[:, None, :] - t[X : Z + 1].T[None]
    gradient = np.einsum("ijn,pnj->pni", metric, offset)
    return np.einsum("pni,pni->pn", gradient, offset) + t[START], gradient


def tissue(
    table: NDArray[np.float32], gland_seeds: int, thickness: float, points: Float64
) -> tuple[NDArray[np.uint8], Float64]:
    """Label of each point and how far (delay) it is from having another one."""
    delay, gradient = delays(table, points)
    row, glandular = np.arange(len(points)), np.arange(table.shape[1]) < gland_seeds
    winner = delay.argmin(axis=1)
    lead = delay - delay[row, winner][:, None]
    steep = np.linalg.norm(gradient - gradient[row, winner][:, None, :], axis=2)
    spare = lead - thickness * steep
    spare[row, winner] = np.inf
    spare[glandular[winner][:, None] & glandular[None]] = np.inf
    label = np.where(glandular[winner], Tissue.GLAND, Tissue.ADIPOSE)
    label[spare.min(axis=1) < 0] = Tissue.LIGAMENT
    others = np.where(glandular[None] == glandular[winner][:, None], np.inf, lead)
    doubt = np.minimum(np.abs(spare).min(axis=1), others.min(axis=1))
    return label.astype(np.uint8), doubt


def two_largest(table: NDArray[np.float32], thickness: float, points: Float64) -> NDArray[np.bool_]:
    """Where the two largest f alone draw a ligament: |f1 - f2| / |grad(f1 - f2)| < thickness / 2."""
    delay, gradient = delays(table, points)
    row, order = np.arange(len(points)), np.argsort(delay, axis=1)
    first, second = order[:, 0], order[:, 1]
    f_difference = (delay[row, second] - delay[row, first]) / 2
    slope = np.linalg.norm(gradient[row, first] - gradient[row, second], axis=1)
    result: NDArray[np.bool_] = f_difference < thickness / 2 * slope
    return result


def grow_regions(table: NDArray[np.float32], grid: Grid, inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Seed of every voxel of ``inside`` (nz, ny, nx), -1 elsewhere: each seed grows from its own voxel to the six
    neighbours, and a voxel belongs to whichever reaches it first."""
    zyx = np.stack(np.meshgrid(*(grid.centres(axis) for axis in "zyx"), indexing="ij"), axis=-1)
    delay, _ = delays(table, zyx[inside][:, ::-1])
    number = np.full(grid.shape, -1)
    number[inside] = np.arange(len(delay))
    owner = np.full(grid.shape, -1)
    front: list[tuple[float, int, tuple[int, int, int]]] = []
    for seed in range(table.shape[1]):
        start = tuple(int((table[axis, seed] - grid.corner[axis]) // grid.spacing[axis]) for axis in (Z, Z - 1, X))
        if inside[start]:
            heapq.heappush(front, (delay[number[start], seed], seed, start))
    steps = [s for s in itertools.product((-1, 0, 1), repeat=3) if sum(map(abs, s)) == 1]
    while front:
        _, seed, voxel = heapq.heappop(front)
        if owner[voxel] >= 0:
            continue
        owner[voxel] = seed
        for step in steps:
            neighbour = (voxel[0] + step[0], voxel[1] + step[1], voxel[2] + step[2])
            if all(0 <= n < size for n, size in zip(neighbour, grid.shape, strict=True)) and (
                inside[neighbour] and owner[neighbour] < 0
            ):
                heapq.heappush(front, (delay[number[neighbour], seed], seed, neighbour))
    return owner
