"""The smoothed occupancy between its samples, and where it passes the level of the outline."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit
from simcore.mesh.surface import OccupancyField

_HALVINGS = 30
_RIM_DIRECTIONS = 32

Points = NDArray[np.float64]


@njit(cache=True, nogil=True)
def value_at(values: Any, origin: Any, spacing: Any, x: float, y: float, z: float) -> float:
    """Trilinear; beyond the samples the nearest one, so that the field goes on unchanged up to the wall."""
    nz, ny, nx = values.shape
    u = min(max((x - origin[0]) / spacing[0], 0.0), nx - 1.0)
    v = min(max((y - origin[1]) / spacing[1], 0.0), ny - 1.0)
    w = min(max((z - origin[2]) / spacing[2], 0.0), nz - 1.0)
    i, j, k = min(int(u), nx - 2), min(int(v), ny - 2), min(int(w), nz - 2)
    u, v, w = u - i, v - j, w - k
    near = (values[k, j, i] * (1 - u) + values[k, j, i + 1] * u) * (1 - v)
    near += (values[k, j + 1, i] * (1 - u) + values[k, j + 1, i + 1] * u) * v
    far = (values[k + 1, j, i] * (1 - u) + values[k + 1, j, i + 1] * u) * (1 - v)
    far += (values[k + 1, j + 1, i] * (1 - u) + values[k + 1, j + 1, i + 1] * u) * v
    return float(near * (1 - w) + far * w)


@njit(cache=True, nogil=True)
def _sample(values: Any, origin: Any, spacing: Any, points: Any, result: Any) -> None:
    for n in range(len(points)):
        result[n] = value_at(values, origin, spacing, points[n, 0], points[n, 1], points[n, 2])


@njit(cache=True, nogil=True)
def _crossing(values: Any, origin: Any, spacing: Any, level: float, start: Any, end: Any, inside: Any, t: Any) -> None:
    for n in range(len(start)):
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            x = start[n, 0] + middle * (end[n, 0] - start[n, 0])
            y = start[n, 1] + middle * (end[n, 1] - start[n, 1])
            z = start[n, 2] + middle * (end[n, 2] - start[n, 2])
            if (value_at(values, origin, spacing, x, y, z) > level) == inside[n]:
                low = middle
            else:
                high = middle
        t[n] = 0.5 * (low + high)


def sample(field: OccupancyField, points: Points) -> NDArray[np.float64]:
    """Values at (n, 3) points, mm."""
    result = np.empty(len(points))
    _sample(field.values, field.origin, field.spacing, points, result)
    return result


def crossing(
    field: OccupancyField, start: Points, end: Points, starts_inside: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Fractions of the way from ``start`` to ``end``, (n,), where the field passes its level, by bisection."""
    result = np.empty(len(start))
    _crossing(field.values, field.origin, field.spacing, field.level, start, end, starts_inside, result)
    return result


def rim_point(field: OccupancyField, points: Points, reach: float) -> Points:
    """The point of the rim nearest to each of ``points`` in the wall, itself where the rim is further than ``reach``
    (mm): the outline then leans so much that it lies near the point without meeting the wall there."""
    angle = np.arange(_RIM_DIRECTIONS) * (2 * np.pi / _RIM_DIRECTIONS)
    directions = np.stack([np.zeros(_RIM_DIRECTIONS), np.cos(angle), np.sin(angle)], axis=1)
    start = np.repeat(points, _RIM_DIRECTIONS, axis=0)
    ends = start + reach * np.tile(directions, (len(points), 1))
    inside = sample(field, start) > field.level
    crosses = inside != (sample(field, ends) > field.level)
    fraction = np.where(crosses, crossing(field, start, ends, inside), np.inf).reshape(len(points), _RIM_DIRECTIONS)
    nearest = fraction.argmin(axis=1)
    best = fraction[np.arange(len(points)), nearest]
    move = np.where(np.isfinite(best), best, 0.0) * reach
    return np.asarray(points + move[:, None] * directions[nearest])
