"""The outline of a label volume as a closed triangle surface with a flat chest wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, label
from skimage.measure import marching_cubes

from simcore.core.artifacts import Phantom
from simcore.core.errors import MeshError
from simcore.mesh.occupancy import block_occupancy

REFERENCE_VOLUME_ML = 700.0
"""Volume for which lengths of a mesh specification are meant."""
BLOCK_PER_EDGE = 0.36
"""Edge of the blocks in which the outline is resolved over the wanted edge of the tetrahedra ..."""
LARGEST_BLOCK_MM = 4.0
"""... but not more than this for a breast of REFERENCE_VOLUME_ML."""
SMOOTHING_BLOCKS = 0.7
"""Standard deviation of the Gaussian that takes away the steps of the blocks ..."""
SMOOTHING_VOXELS = 1.2
"""... and at least this many voxels: where a block is one voxel, it is all or nothing."""
_MARGIN = 4
_LEVELS = (0.2, 0.8)
"""Range of the iso-surface level."""

Axes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Coordinates of the sample layers along (z, y, x), mm."""


@dataclass(frozen=True, eq=False)
class OccupancyField:
    """Smoothed share of body at regular samples; the outline is its iso-surface at ``level``.

    values: float32 (nz, ny, nx); constant along x between the wall and the first sample.
    origin, spacing: float64 (3,) (x, y, z) of the first sample and between samples, mm.
    """

    values: NDArray[np.float32]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    level: float

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest (x, y, z) of the samples above the level, mm."""
        above = self.values > self.level
        ends = [np.flatnonzero(above.any(axis=others))[[0, -1]] for others in ((0, 1), (0, 2), (1, 2))]
        low, high = np.array(ends).T
        return self.origin + low * self.spacing, self.origin + high * self.spacing


@dataclass(frozen=True, eq=False)
class Outline:
    """A closed surface with outward triangles.

    points: float64 (n, 3) (x, y, z), mm. triangles: int32 (f, 3).
    volume: of the labels inside, mm^3 (the surface encloses the same within its own precision).
    scale: cube root of the volume over REFERENCE_VOLUME_ML.
    field: whose iso-surface it is.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]
    volume: float
    scale: float
    field: OccupancyField


def enclosed_volume(points: NDArray[np.float64], triangles: NDArray[np.int32]) -> float:
    """Volume inside a closed surface, mm^3; positive where the triangles point outwards."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def in_front_of_wall(phantom: Phantom) -> NDArray[np.uint8]:
    """The labels with x > 0, a view.

    raises: MeshError where x = 0 cuts through voxels, or the first layer in front of it has no body.
    """
    layers = -phantom.grid.corner[0] / phantom.grid.spacing[0]
    first = round(layers)
    if abs(layers - first) > 1e-3 or not 0 <= first < phantom.grid.shape[2]:
        raise MeshError(
            f"the chest wall x = 0 does not lie between two voxel layers: the grid begins at x = "
            f"{phantom.grid.corner[0]:g} mm with voxels of {phantom.grid.spacing[0]:g} mm; move the grid",
            code="mesh-no-wall",
        )
    labels = phantom.labels[:, :, first:]
    if not labels[:, :, 0].any():
        raise MeshError(
            "no body at the chest wall: the voxel layer in front of x = 0 is all air; move the volume so that the "
            "breast begins at x = 0",
            code="mesh-no-wall",
        )
    return labels


def outline(phantom: Phantom, edge_length: float = 5.5) -> Outline:
    """Block-mean occupancy, a light Gaussian, marching cubes at the level that encloses the volume of the labels.

    edge_length: wanted of the tetrahedra for a breast of REFERENCE_VOLUME_ML, mm.
    raises: MeshError where the chest wall is missing or the body falls into pieces.
    """
    labels = in_front_of_wall(phantom)
    spacing = np.array(phantom.grid.spacing)[::-1]
    rough = float(np.count_nonzero(labels[::2, ::2, ::2])) * 8 * phantom.grid.voxel_volume
    scale = (max(rough, phantom.grid.voxel_volume) / (REFERENCE_VOLUME_ML * 1e3)) ** (1 / 3)
    resolution = scale * min(BLOCK_PER_EDGE * edge_length, LARGEST_BLOCK_MM)
    block = np.maximum(1, np.round(resolution / spacing)).astype(int)
    occupancy = block_occupancy(labels, (int(block[0]), int(block[1]), int(block[2])))
    step = spacing * block
    volume = float(occupancy.sum(dtype=np.float64) * np.prod(step))
    _require_one_piece(occupancy)

    margin = [(_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, _MARGIN)]
    # Mirrored at the wall, so that the smoothing does not pull the outline in where it meets the wall.
    sigma = np.maximum(SMOOTHING_BLOCKS, SMOOTHING_VOXELS / block)
    smooth = gaussian_filter(np.pad(occupancy, margin), sigma, mode=["constant", "constant", "reflect"])
    if smooth.max() <= _LEVELS[1]:
        raise MeshError(
            f"the body is only about {(volume / phantom.grid.voxel_volume) ** (1 / 3):.1f} voxels across: too few for "
            "an outline; use smaller voxels",
            code="mesh-empty",
        )
    axes = (
        phantom.grid.corner[2] + (np.arange(smooth.shape[0]) + 0.5 - _MARGIN) * step[0],
        phantom.grid.corner[1] + (np.arange(smooth.shape[1]) + 0.5 - _MARGIN) * step[1],
        np.concatenate([[0.0, 0.0], (np.arange(smooth.shape[2]) + 0.5) * step[2]]),
    )
    points, triangles, level = _surface_of_volume(smooth, volume, axes)
    field = OccupancyField(smooth, np.array([axes[2][2], axes[1][0], axes[0][0]]), step[::-1].copy(), level)
    return Outline(points, triangles, volume, (volume / (REFERENCE_VOLUME_ML * 1e3)) ** (1 / 3), field)


def _require_one_piece(occupancy: NDArray[np.float32]) -> None:
    pieces, count = label(occupancy >= 0.5)
    if count == 0:
        raise MeshError(
            "the body is thinner than a voxel block everywhere: nothing to mesh; use smaller voxels",
            code="mesh-empty",
        )
    sizes = np.bincount(pieces.ravel())[1:]
    if sizes.max() < 0.99 * sizes.sum():
        raise MeshError(
            f"the body falls into {count} pieces, the largest with {sizes.max() / sizes.sum():.0%} of the volume; "
            "only one connected body can be compressed: clear the other labels",
            code="mesh-pieces",
        )
    if count > 1:
        largest = 1 + int(sizes.argmax())
        occupancy[(pieces != largest) & (pieces > 0)] = 0


def _surface_of_volume(
    occupancy: NDArray[np.float32], volume: float, axes: Axes
) -> tuple[NDArray[np.float64], NDArray[np.int32], float]:
    """The iso-surface that encloses ``volume`` and its level: smoothing shrinks what is convex, a lower level makes up
    for it."""
    level = 0.5
    last_level, last_error = 0.0, 0.0
    for _ in range(5):
        drawn = level
        points, triangles = _iso_surface(occupancy, drawn, axes)
        error = enclosed_volume(points, triangles) - volume
        if abs(error) < 1e-4 * volume:
            break
        if last_level:
            slope = (error - last_error) / (level - last_level)
        else:
            # The smoothed edge is about this wide, the surface of a compact body about 5 volume^(2/3).
            slope = -5 * volume ** (2 / 3) * 2.5 * SMOOTHING_BLOCKS * float(axes[0][1] - axes[0][0])
        last_level, last_error = level, error
        level = float(np.clip(level - error / slope, *_LEVELS))
        if level == last_level:
            break
    return points, triangles, drawn


def _iso_surface(
    occupancy: NDArray[np.float32], level: float, axes: Axes
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Marching cubes closed at the wall: two layers at x = 0, one that goes on as the first layer of blocks and one
    that is outside everywhere, so that all triangles between them lie in the plane and end at a sharp rim."""
    first = occupancy[:, :, :1]
    field = np.concatenate([np.zeros_like(first), first, occupancy], axis=2)
    field[field == np.float32(level)] += 1e-6
    indices, faces, _, _ = marching_cubes(field, level, method="lewiner")
    points = np.stack(
        [np.interp(indices[:, k], np.arange(len(axis)), axis) for k, axis in enumerate(axes)][::-1], axis=1
    )
    triangles = faces.astype(np.int32)
    if enclosed_volume(points, triangles) < 0:
        triangles = triangles[:, ::-1]
    return np.ascontiguousarray(points), np.ascontiguousarray(triangles)
