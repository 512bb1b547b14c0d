"""Where the compressed phantom lies: its voxel grid, and which of its layers lie between the plates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simcore.core.grid import Grid
from simcore.warp.pieces import Pieces

BEYOND_MM = 1e-3
"""Nodes that pass a plate, or the chest wall, by less lie on it."""
_SLACK = 1e-6


@dataclass(frozen=True)
class Placing:
    """grid: of the compressed phantom, support frame. plates: its layers from plate to plate, the last of which the
    upper plate may cut; inside: one more than the last with its centre below that plate."""

    grid: Grid
    plates: tuple[int, int]
    inside: int

    @property
    def below_mm(self) -> float:
        """How far the grid reaches below the lower plate, mm."""
        return self.plates[0] * self.grid.spacing[2]

    @property
    def above_mm(self) -> float:
        """How far it reaches above the layer that the upper plate cuts, mm."""
        return (self.grid.shape[0] - self.plates[1]) * self.grid.spacing[2]


def placing(deformed: NDArray[np.float64], thickness: float, margin_mm: float, source: Grid) -> Placing:
    """The grid of the compressed phantom, support frame, with the voxel edges of ``source``.

    It is symmetric about y = 0, begins at x = 0 and reaches from plate to plate (z = 0 is the lower one): where the
    body reaches beyond, as beside the rim of a fixed chest wall, by as many voxels more. A grid whose voxel centres lie
    on y = 0 keeps them there.
    """
    edge_x, edge_y, edge_z = source.spacing
    low, high = deformed.min(axis=0), deformed.max(axis=0)
    behind = _voxels(-low[0], margin_mm, edge_x)
    nx = behind + max(1, math.ceil((high[0] + margin_mm) / edge_x - _SLACK))
    half = (np.abs(deformed[:, 1]).max() + margin_mm) / edge_y - _SLACK
    centred = abs((source.corner[1] / edge_y) % 1.0 - 0.5) < 0.25
    ny = 2 * math.ceil(half - 0.5) + 1 if centred else 2 * math.ceil(half)
    below, above = _voxels(-low[2], margin_mm, edge_z), _voxels(high[2] - thickness, margin_mm, edge_z)
    between = max(1, math.ceil(thickness / edge_z - _SLACK))
    return Placing(
        Grid((below + between + above, ny, nx), source.spacing, (-behind * edge_x, -ny * edge_y / 2, -below * edge_z)),
        (below, below + between),
        below + math.floor(thickness / edge_z + 0.5 + 1e-9),
    )


def _voxels(reach_mm: float, margin_mm: float, edge: float) -> int:
    """How many it takes beyond a plane that the body passes by ``reach_mm``."""
    return math.ceil((reach_mm + margin_mm) / edge - _SLACK) if reach_mm > BEYOND_MM else 0


def within_plates(pieces: Pieces, where: Placing, beyond: NDArray[np.bool_]) -> Pieces:
    """The pieces cut at the plates, but for those that are ``beyond`` (p, 2) the lower, the upper one: the surface of
    the body stops at a plate, except where it has left it."""
    bounds = pieces.bounds.copy()
    lower, upper = ~beyond[:, 0], ~beyond[:, 1]
    bounds[lower, 0, 2] = np.maximum(bounds[lower, 0, 2], where.plates[0])
    bounds[upper, 1, 2] = np.minimum(bounds[upper, 1, 2], where.inside - 1)
    return replace(pieces, bounds=bounds)


def trimmed(labels: NDArray[np.uint8], where: Placing) -> tuple[NDArray[np.uint8], Placing]:
    """Without empty layers beyond the plates."""
    first, stop = where.plates
    filled = [k for k in (*range(first), *range(stop, len(labels))) if labels[k].any()]
    start, end = min([first, *filled]), max([stop - 1, *filled]) + 1
    if (start, end) == (0, len(labels)):
        return labels, where
    grid = where.grid
    corner = (grid.corner[0], grid.corner[1], grid.corner[2] + start * grid.spacing[2])
    return np.ascontiguousarray(labels[start:end]), Placing(
        Grid((end - start, *grid.shape[1:]), grid.spacing, corner), (first - start, stop - start), where.inside - start
    )
