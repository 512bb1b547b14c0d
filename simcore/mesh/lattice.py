"""Tetrahedra by isosurface stuffing: a body-centred cubic lattice that is cut where the outline passes.

Corners of the lattice that come too near to the outline are moved onto it, what remains across it is cut. The chest
wall x = 0 is a mirror plane of the lattice made of whole faces, so the elements at the wall are those of the inside,
and the rim where skin meets wall is sharp. No step depends on the order of threads.

Source: Labelle, Shewchuk, Isosurface stuffing: fast tetrahedral meshes with good dihedral angles, ACM Trans. Graph. 26
(2007) 57; the orientation that keeps the wall whole is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.mesh.lattice_field import crossing, rim_point, sample
from simcore.mesh.lattice_smoothing import smoothed
from simcore.mesh.lattice_stencils import CORNERS, EDGES, LONG_STEPS, SHAPE, STEPS, table
from simcore.mesh.surface import OccupancyField

NEAR_LONG, NEAR_SHORT = 0.24999, 0.41189
"""A cut nearer to a corner than this fraction of a long or short edge pulls the corner onto it. Values of the source
for the largest smallest angle."""
_NEAR = np.array([NEAR_LONG if tuple(s) in LONG_STEPS else NEAR_SHORT for s in STEPS.tolist()])
_EDGE_NEAR = np.array([NEAR_LONG, NEAR_LONG] + 4 * [NEAR_SHORT])

Ids = NDArray[np.int64]
Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Lattice:
    """points: (n, 3) int (p, q, k), p >= 0; number: dense (p, q, k) - low -> row of points, -1 where there is none."""

    points: Ids
    number: Ids
    low: Ids

    def find(self, points: Ids) -> Ids:
        """Rows of points, -1 for those that are not in the lattice."""
        index = points - self.low
        inside = np.asarray(((index >= 0) & (index < self.number.shape)).all(axis=-1))
        index = np.where(inside[..., None], index, 0)
        return np.where(inside, self.number[index[..., 0], index[..., 1], index[..., 2]], -1)


def stuffed(field: OccupancyField, constant: float) -> tuple[Points, Ids]:
    """Tetrahedra inside the iso-surface of a field.

    constant: edge of the cubic cell of the lattice, mm; a whole tetrahedron has constant^3 / 12.
    returns: nodes float64 (n, 3), mm, those of the wall with x == 0; tets int64 (m, 4), positive.
    """
    lattice = _lattice_over(field, constant)
    nodes = lattice.points * (SHAPE * constant)
    inside = sample(field, nodes) > field.level
    ends, kind = _crossed_edges(lattice, inside)
    fraction = crossing(field, nodes[ends[:, 0]], nodes[ends[:, 1]], inside[ends[:, 0]])
    cuts = nodes[ends[:, 0]] + fraction[:, None] * (nodes[ends[:, 1]] - nodes[ends[:, 0]])
    sign = np.where(inside, 1, -1)
    nodes, sign = _warped(field, constant, nodes, sign, ends, kind, fraction, cuts)
    nodes, tets, on_surface = _filled(lattice, nodes, sign, ends, cuts)
    return smoothed(field, nodes, tets, on_surface, constant), tets


def _lattice_over(field: OccupancyField, constant: float) -> _Lattice:
    """All lattice points within two cells of where the field lies above its level."""
    low, high = field.bounds()
    step = SHAPE * constant
    first = np.floor(low / step).astype(np.int64) - 3
    last = np.ceil(high / step).astype(np.int64) + 3
    first[0] = 0
    axes = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    is_point = grid.sum(axis=-1) % 2 == 0
    number = np.full(is_point.shape, -1, dtype=np.int64)
    number[is_point] = np.arange(np.count_nonzero(is_point))
    return _Lattice(grid[is_point], number, first)


def _crossed_edges(lattice: _Lattice, inside: NDArray[np.bool_]) -> tuple[Ids, Ids]:
    """Edges whose ends lie on different sides: ends (m, 2), kind (m,) rows of STEPS."""
    ends, kinds = [], []
    for kind, step in enumerate(STEPS):
        other = lattice.find(lattice.points + step)
        crossed = np.flatnonzero((other >= 0) & (inside != inside[other]))
        ends.append(np.stack([crossed, other[crossed]], axis=1))
        kinds.append(np.full(len(crossed), kind))
    return np.concatenate(ends), np.concatenate(kinds)


def _warped(
    field: OccupancyField,
    constant: float,
    nodes: Points,
    sign: Ids,
    ends: Ids,
    kind: Ids,
    fraction: NDArray[np.float64],
    cuts: Points,
) -> tuple[Points, Ids]:
    """Corners with a cut too near moved onto the nearest such cut, their sign made zero. A corner on the wall goes to
    cuts in the wall; where there are none near, to the rim, in the plane."""
    near_first, near_second = fraction < _NEAR[kind], fraction > 1 - _NEAR[kind]
    corner = np.concatenate([ends[near_first, 0], ends[near_second, 1]])
    cut = np.concatenate([np.flatnonzero(near_first), np.flatnonzero(near_second)])
    distance = np.linalg.norm(cuts[cut] - nodes[corner], axis=1)
    leaves_wall = (nodes[corner, 0] == 0) & (cuts[cut, 0] > 0)
    order = np.lexsort((cut, distance, leaves_wall, corner))
    corner, first = np.unique(corner[order], return_index=True)
    cut, leaves_wall = cut[order][first], leaves_wall[order][first]
    target = cuts[cut]
    target[leaves_wall] = rim_point(field, nodes[corner[leaves_wall]], NEAR_LONG * constant)
    nodes, sign = nodes.copy(), sign.copy()
    nodes[corner], sign[corner] = target, 0
    return nodes, sign


def _filled(
    lattice: _Lattice, nodes: Points, sign: Ids, ends: Ids, cuts: Points
) -> tuple[Points, Ids, NDArray[np.bool_]]:
    """The stencil of every tetrahedron that reaches inside: nodes, tetrahedra, which nodes lie on the outline."""
    count, corners = table()
    left = sign[ends[:, 0]] * sign[ends[:, 1]] < 0
    ends, cuts = ends[left], cuts[left]
    key = np.minimum(ends[:, 0], ends[:, 1]) * len(nodes) + np.maximum(ends[:, 0], ends[:, 1])
    order = np.argsort(key)
    key, cuts = key[order], cuts[order]
    parts = []
    for t, offsets in enumerate(CORNERS):
        corner = np.stack([lattice.find(lattice.points + o) for o in offsets], axis=1)
        corner = corner[(corner >= 0).all(axis=1)]
        pattern = sign[corner] @ np.array([27, 9, 3, 1]) + 40
        used = count[t, pattern] > 0
        corner, pattern = corner[used], pattern[used]
        edge_key = np.stack([corner[:, list(e)].min(1) * len(nodes) + corner[:, list(e)].max(1) for e in EDGES], axis=1)
        local = np.concatenate([corner, len(nodes) + np.searchsorted(key, edge_key)], axis=1)
        for m in range(3):
            has = count[t, pattern] > m
            parts.append(np.take_along_axis(local[has], corners[t, pattern[has], m], axis=1))
    on_surface = np.concatenate([sign == 0, np.ones(len(cuts), dtype=bool)])
    return np.concatenate([nodes, cuts]), np.concatenate(parts), on_surface
