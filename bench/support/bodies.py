"""Bodies and meshes that the benches share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.mesh.quality import quality_report
from simcore.mesh.structured import box, half_ellipsoid

Floats = NDArray[np.float64]
SemiAxes = tuple[float, float, float, float]

C_CUP: SemiAxes = (92.1, 60.2, 67.3, 53.1)
"""Semi-axes (x, y, z above, z below) of a half ellipsoid of 700 ml, mm."""
ONE_TISSUE = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
"""For laws that do not look at the labels."""
MIDSIDES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Corners on either side of nodes 5 to 10 of a quadratic tetrahedron."""


def as_quadratic(semi_axes: SemiAxes, cells: int) -> tuple[TetMesh, NDArray[np.int64]]:
    """A half ellipsoid meshed twice with the same nodes.

    cells: even. returns: (linear tetrahedra, ``half_ellipsoid(semi_axes, cells)``; ten-node tetrahedra (m / 8, 10) of
    its nodes, which are curved: half as many cells, what lies between their corners becomes mid-side nodes)
    """
    fine, coarse = half_ellipsoid(semi_axes, cells), half_ellipsoid(semi_axes, cells // 2)
    lattice = _octahedral(coarse.nodes, semi_axes)
    ends = coarse.tets[:, np.array(MIDSIDES)]
    points = np.concatenate([lattice[coarse.tets], lattice[ends].mean(axis=2)], axis=1)
    distance, tets = cKDTree(_octahedral(fine.nodes, semi_axes)).query(points)
    assert np.max(distance) < 1e-9
    return fine, np.asarray(tets, dtype=np.int64)


def _octahedral(nodes: Floats, semi_axes: SemiAxes) -> Floats:
    """Where ``half_ellipsoid`` had the nodes before the octahedron |x| + |y| + |z| <= 1 became an ellipsoid."""
    a, b, upper, lower = semi_axes
    ball = nodes / np.stack(
        [np.full(len(nodes), a), np.full(len(nodes), b), np.where(nodes[:, 2] > 0, upper, lower)], 1
    )
    radius = np.linalg.norm(ball, axis=1, keepdims=True)
    octahedral: Floats = ball * radius / np.maximum(np.abs(ball).sum(axis=1, keepdims=True), 1e-12)
    return octahedral


def scaled_to(semi_axes: SemiAxes, volume_ml: float) -> SemiAxes:
    """The half ellipsoid of that volume, V = pi/3 a b (c_upper + c_lower)."""
    a, b, upper, lower = semi_axes
    factor = (1e3 * volume_ml / (np.pi / 3 * a * b * (upper + lower))) ** (1 / 3)
    return (a * factor, b * factor, upper * factor, lower * factor)


def ellipsoid_labels(semi_axes: SemiAxes, voxel: float = 1.0) -> Phantom:
    """A half ellipsoid of adipose tissue as labels.

    semi_axes: (x, y, z above, z below), mm. voxel: edge, mm.
    """
    a, b, upper, lower = semi_axes
    margin = 3
    nx = int(np.ceil(a / voxel)) + margin
    ny = 2 * (int(np.ceil(b / voxel)) + margin)
    below, above = (int(np.ceil(c / voxel)) + margin for c in (lower, upper))
    corner = (0.0, -ny / 2 * voxel, -below * voxel)
    grid = Grid((below + above, ny, nx), (voxel, voxel, voxel), corner)
    x, y, z = (grid.centres(axis) for axis in "xyz")
    height = np.where(z > 0, upper, lower)
    inside = (z / height)[:, None, None] ** 2 + (y / b)[None, :, None] ** 2 + (x / a)[None, None, :] ** 2 <= 1
    return Phantom(np.where(inside, np.uint8(Tissue.ADIPOSE), np.uint8(Tissue.AIR)), grid)


def cushion(half_width: float, radius: float, cells: int) -> TetMesh:
    """A cube 0 <= x <= half_width, |y| and |z| <= half_width, whose upper and lower faces are bent to ``radius``, mm,
    with small elements around the two summits: for contact patches much smaller than the body.

    cells: along x; 24 cells^3 tetrahedra.
    """
    cube = box((1.0, 2.0, 2.0), (cells, 2 * cells, 2 * cells))
    x, y = cube.nodes[:, 0] ** 2, np.sign(cube.nodes[:, 1]) * cube.nodes[:, 1] ** 2
    z = np.sign(cube.nodes[:, 2]) * (1 - (1 - np.abs(cube.nodes[:, 2])) ** 2)
    sag = half_width * (x**2 + y**2) / (2 * radius)
    nodes = half_width * np.stack([x, y, z * (1 - sag)], axis=1)
    return TetMesh(nodes, cube.tets, cube.wall, cube.skin, quality_report(nodes, cube.tets))
