"""A breast-like scene with closed-form line integrals: masses in thin capsules in a ball of fat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue

SIZE = 48.0
"""Edge of the cube that the labels fill, mm."""
CAPSULE = 0.4

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Balls:
    """centres (n, 3), mm in the support frame; radii (n,); labels (n,): what lies inside. Later ones replace earlier
    ones and lie wholly within one of them or beside."""

    centres: Array
    radii: Array
    labels: NDArray[np.uint8]
    within: NDArray[np.uint8]
    """label of what each replaces"""


def balls(seed: int = 1, count: int = 25) -> Balls:
    """Disjoint capsules at random places in a ball of fat."""
    rng = np.random.default_rng(seed)
    outer = SIZE / 2 - 1.0
    middle = np.array([SIZE / 2, 0.0, SIZE / 2])
    placed: list[tuple[Array, float]] = []
    while len(placed) < count:
        radius = rng.uniform(2.0, 5.0)
        centre = middle + rng.uniform(-outer, outer, 3)
        inside = np.linalg.norm(centre - middle) + radius < outer - 0.5
        if inside and all(np.linalg.norm(centre - c) > radius + r + 0.3 for c, r in placed):
            placed.append((centre, radius))
    centres, radii, labels, within = [middle], [outer], [Tissue.ADIPOSE], [Tissue.AIR]
    for centre, radius in placed:
        centres += [centre, centre]
        radii += [radius, radius - CAPSULE]
        labels += [Tissue.LIGAMENT, Tissue.MASS]
        within += [Tissue.ADIPOSE, Tissue.LIGAMENT]
    return Balls(np.array(centres), np.array(radii), np.array(labels, np.uint8), np.array(within, np.uint8))


def voxels(scene: Balls, edge: float) -> Phantom:
    """Labels at the voxel centres."""
    cells = round(SIZE / edge)
    grid = Grid((cells, cells, cells), (edge, edge, edge), (0.0, -SIZE / 2, 0.0))
    labels = np.zeros(grid.shape, np.uint8)
    for centre, radius, label in zip(scene.centres, scene.radii, scene.labels, strict=True):
        low = np.maximum(np.floor((centre - radius - grid.corner) / edge).astype(int), 0)
        high = np.minimum(np.ceil((centre + radius - grid.corner) / edge).astype(int), cells)
        x, y, z = (grid.centres("xyz"[a])[low[a] : high[a]] - centre[a] for a in range(3))
        box = labels[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
        box[x**2 + y[:, None] ** 2 + z[:, None, None] ** 2 <= radius**2] = label
    return Phantom(labels, grid)


def integrals(scene: Balls, geometry: AcquisitionGeometry, view: int, mu: Array) -> Array:
    """Closed-form line integrals to every pixel centre, (ny, nx)."""
    detector = geometry.detector
    origin, rows = geometry.detector_frame(view)
    source = geometry.sources[view]
    y, x = detector.y_centres()[:, None, None], detector.x_centres()[None, :, None]
    rays = origin + y * rows + x * geometry.column_direction(view) - source
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    total = np.zeros(rays.shape[:2])
    lift = np.array([0.0, 0.0, geometry.support_height])
    for centre, radius, label, within in zip(scene.centres, scene.radii, scene.labels, scene.within, strict=True):
        towards = centre + lift - source
        distance2 = towards @ towards - (rays @ towards) ** 2
        total += 2 * np.sqrt(np.maximum(radius**2 - distance2, 0.0)) * (mu[label] - mu[within])
    return total
