"""Rays and voxels of a subset of views, with the sums of their interpolation weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.reconstruction.operators.corrections import Lengths, ray_sums, voxel_sums
from simcore.reconstruction.operators.crossings import Crossings
from simcore.reconstruction.operators.slice_kernels import Gathering

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class ViewSums:
    """Of the rays of one view. along_y: float32 (nz, ny), along_x: float32 (nz, nx), their product summed over slices
    is the row sum; lengths: see ``corrections``."""

    along_y: FloatArray
    along_x: FloatArray
    lengths: Lengths


def view_sums(crossings: Crossings, view: int) -> ViewSums:
    detector, grid = crossings.geometry.detector, crossings.grid
    nz, ny, nx = grid.shape
    source_x, source_y, source_z = crossings.geometry.sources[view]
    offsets, steps = crossings.offsets[view], crossings.steps[view]
    return ViewSums(
        np.stack([ray_sums(offsets[z, 0], steps[z, 0], detector.ny, ny) for z in range(nz)]),
        np.stack([ray_sums(offsets[z, 1], steps[z, 1], detector.nx, nx) for z in range(nz)]),
        (
            (((detector.y_centres() - source_y) / source_z) ** 2).astype(np.float32),
            (((detector.x_centres() - source_x) / source_z) ** 2).astype(np.float32),
            grid.spacing[2],
        ),
    )


@dataclass(frozen=True)
class SubsetSums:
    """How voxels read the projections of a subset, and their column sums: float32 (groups, nz, ny) and
    (groups, nz, nx), whose products summed over groups they are."""

    gathering: Gathering
    along_y: FloatArray
    along_x: FloatArray


def subset_sums(crossings: Crossings, views: NDArray[np.int64]) -> SubsetSums:
    detector, grid = crossings.geometry.detector, crossings.grid
    gathering = crossings.gathering(views)
    order, group_start = gathering[:2]
    groups = len(group_start) - 1
    nz, ny, nx = grid.shape
    along_y = np.zeros((groups, nz, ny), np.float32)
    along_x = np.empty((groups, nz, nx), np.float32)
    for group in range(groups):
        members = views[order[group_start[group] : group_start[group + 1]]]
        for z in range(nz):
            for view in members:
                offsets, steps = crossings.offsets[view, z], crossings.steps[view, z]
                along_y[group, z] += voxel_sums(offsets[0], steps[0], detector.ny, ny)
            along_x[group, z] = voxel_sums(offsets[1], steps[1], detector.nx, nx)
    return SubsetSums(gathering, along_y, along_x)
