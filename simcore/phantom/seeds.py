"""Where compartments start, how large they are and how they lie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit
from simcore.phantom.outline import SemiAxes, similar_radius
from simcore.phantom.spec import AnthropomorphicPhantom, CompartmentSpec

Float64 = NDArray[np.float64]


class Region(IntEnum):
    """Where a seed is planted. What it becomes (adipose or glandular) is settled later."""

    SUBCUTANEOUS = 0
    RETROMAMMARY = 1
    INTERIOR = 2


RELATIVE_VOLUME = {Region.SUBCUTANEOUS: 0.94, Region.RETROMAMMARY: 0.89, Region.INTERIOR: 0.31}
"""Volumes of compartments in breasts, cm^3 (PHYSICS.md section 3); only their ratios are used, since the number of
compartments is given."""

SMALL_VOLUME = 0.15
"""Volume of the small interior compartments relative to the others there. What of them comes to lie in the glandular
region becomes enclosed fat."""

_CANDIDATES = 12
"""Random places tried for each seed; the one farthest from all others is taken."""


@dataclass(frozen=True)
class Layers:
    """Nominal borders of the regions.

    inner:        similar radius at which the subcutaneous layer ends.
    outer:        similar radius of the inner surface of the skin, on average.
    retromammary: thickness of the layer at the chest wall, mm.
    """

    inner: float
    outer: float
    retromammary: float

    def volumes(self, axes: SemiAxes) -> dict[Region, float]:
        """mm^3 per region: the half ellipsoid x >= 0 cut at the plane x = retromammary and at ``inner``."""
        a, b, upper, lower = axes
        whole = math.pi / 3 * a * b * (upper + lower)
        cut = min(1.0, self.retromammary / (self.inner * a))
        interior = whole * self.inner**3 * (1 - 1.5 * cut + 0.5 * cut**3)
        retromammary = whole * self.inner**3 - interior
        return {
            Region.SUBCUTANEOUS: whole * (self.outer**3 - self.inner**3),
            Region.RETROMAMMARY: retromammary,
            Region.INTERIOR: interior,
        }


@dataclass(frozen=True)
class Seeds:
    """Seeds of compartments.

    centres: (n, 3) (x, y, z), mm.
    metrics: (n, 3, 3), S_i, 1/mm^2: the unit ellipsoid of S_i has about the volume of the compartment.
    region:  (n,) Region.
    small:   (n,) bool, see SMALL_VOLUME.
    rank:    (n,) the order in which seeds become glandular: radius in the similar ellipsoids of the fibroglandular
             region, with some noise.
    """

    centres: Float64
    metrics: NDArray[np.float64]
    region: NDArray[np.int64]
    small: NDArray[np.bool_]
    rank: Float64

    def __len__(self) -> int:
        return len(self.centres)


def layers(spec: AnthropomorphicPhantom, axes: SemiAxes, scale: float) -> Layers:
    """The adipose layers of the specification with both thicknesses times ``scale``."""
    outer = 1.0 - spec.skin_mm / float(np.mean(axes))
    inner = max(0.05, outer - scale * spec.compartments.subcutaneous_fraction)
    return Layers(inner, outer, scale * spec.compartments.retromammary_mm)


def plant(
    spec: AnthropomorphicPhantom, axes: SemiAxes, border: Layers, enclosed: float, random: np.random.Generator
) -> Seeds:
    """``spec.compartments.count`` seeds in the three regions, spread evenly.

    enclosed: share of the interior volume that small compartments take up, 0 to 1.
    """
    compartments = spec.compartments
    regions = border.volumes(axes)
    numbers = _share_out(compartments.count, {r: v / RELATIVE_VOLUME[r] for r, v in regions.items()})
    centres, metrics, region, small = [], [], [], []
    small_share = enclosed / (enclosed + SMALL_VOLUME * (1.0 - enclosed))
    placed = np.empty((0, 3))
    placed_radius = np.empty(0)
    for kind, number in numbers.items():
        if number == 0:
            continue
        mean = regions[kind] / number
        is_small = (kind is Region.INTERIOR) & (random.random(number) < small_share)
        shrunk = np.where(is_small, SMALL_VOLUME, 1.0)
        volume = mean * shrunk / shrunk.mean() * np.exp(random.normal(0.0, 0.3, number))
        radius = np.cbrt(volume * 3 / (4 * math.pi))
        candidates, half_thickness = _candidates(kind, number, mean, axes, border, random)
        # Small compartments keep away from one another nearly as if they alone filled the interior, so that no
        # part of it goes without.
        alone = np.cbrt(3 / (4 * math.pi) * regions[kind] / max(1, is_small.sum()))
        apart = np.where(is_small, 0.8 * alone, radius)
        chosen = _farthest(candidates, radius, apart, is_small, placed, placed_radius)
        placed, placed_radius = np.concatenate([placed, chosen]), np.concatenate([placed_radius, radius])
        normal = np.tile([1.0, 0.0, 0.0], (number, 1)) if kind is Region.RETROMAMMARY else _normal(axes, chosen)
        centres.append(chosen)
        metrics.append(_metrics(radius, half_thickness, normal, compartments, random))
        region.append(np.full(number, int(kind)))
        small.append(is_small)
    all_centres = np.concatenate(centres)
    rank = glandular_radius(axes, border, all_centres) * np.exp(random.normal(0.0, 0.08, len(all_centres)))
    return Seeds(
        all_centres, np.concatenate(metrics), np.concatenate(region).astype(np.int64), np.concatenate(small), rank
    )


def glandular_radius(axes: SemiAxes, border: Layers, points: Float64) -> Float64:
    """Scale of the fibroglandular ellipsoid through each point: 0 in its middle, 1 where it touches the layers."""
    a, b, upper, lower = axes
    front, back = border.inner * a, min(border.retromammary, 0.8 * border.inner * a)
    middle, half = (front + back) / 2, (front - back) / 2
    c = np.where(points[:, 2] > 0, upper, lower)
    across = 0.85 * border.inner
    result: Float64 = np.sqrt(
        ((points[:, 0] - middle) / half) ** 2 + (points[:, 1] / (across * b)) ** 2 + (points[:, 2] / (across * c)) ** 2
    )
    return result


def _share_out(total: int, weights: dict[Region, float]) -> dict[Region, int]:
    """``total`` in whole numbers in proportion to the weights (largest remainders)."""
    whole = sum(weights.values())
    exact = {region: total * weight / whole for region, weight in weights.items()}
    numbers = {region: int(share) for region, share in exact.items()}
    rest = sorted(exact, key=lambda region: numbers[region] - exact[region])
    for region in rest[: total - sum(numbers.values())]:
        numbers[region] += 1
    return numbers


def _candidates(
    kind: Region, number: int, mean: float, axes: SemiAxes, border: Layers, random: np.random.Generator
) -> tuple[Float64, Float64 | None]:
    """Places (number, _CANDIDATES, 3) and, in the layers, the half thickness of the compartments (number,), mm."""
    total = number * _CANDIDATES
    if kind is Region.INTERIOR:
        return _interior_points(total, mean, axes, border, random).reshape(number, _CANDIDATES, 3), None
    points = _ellipsoid_points(total, axes, random)
    radius = similar_radius(axes, points[:, 0], points[:, 1], points[:, 2])[:, None]
    if kind is Region.SUBCUTANEOUS:
        share = border.outer - border.inner
        thickness = share * np.linalg.norm(points, axis=1) / radius[:, 0]
        sheets = max(1, round(float(thickness.mean()) / np.cbrt(mean)))
        points *= (border.inner + share * _depth(sheets, number, random)[:, None]) / radius
    else:
        thickness = np.full(total, border.retromammary)
        sheets = max(1, round(border.retromammary / np.cbrt(mean)))
        points = border.inner * _disc_points(total, axes, random)
        points[:, 0] = border.retromammary * _depth(sheets, number, random)
    half = thickness.reshape(number, _CANDIDATES).mean(axis=1) / (2 * sheets)
    return points.reshape(number, _CANDIDATES, 3), half


def _depth(sheets: int, number: int, random: np.random.Generator) -> Float64:
    """Relative depth in a layer of ``sheets`` sheets of compartments, the same for all candidates of a seed."""
    sheet = random.integers(0, sheets, number) + 0.5 + 0.15 * (2 * random.random(number) - 1)
    depth: Float64 = np.repeat(sheet / sheets, _CANDIDATES)
    return depth


def _ellipsoid_points(number: int, axes: SemiAxes, random: np.random.Generator) -> Float64:
    """Points spread evenly over the breast outline."""
    a, b, upper, lower = axes
    points: Float64 = random.normal(size=(number, 3))
    points *= (np.cbrt(random.random(number)) / np.linalg.norm(points, axis=1))[:, None]
    c = np.where(random.random(number) * (upper + lower) < upper, upper, -lower)
    points[:] = np.abs(points) * np.stack([np.full(number, a), np.full(number, b), c], axis=1)
    points[:, 1] *= np.where(random.random(number) < 0.5, 1.0, -1.0)
    return points


def _disc_points(number: int, axes: SemiAxes, random: np.random.Generator) -> Float64:
    """Points spread evenly over the chest wall, x = 0."""
    _, b, upper, lower = axes
    radius, angle = np.sqrt(random.random(number)), math.pi * random.random(number)
    c = np.where(random.random(number) * (upper + lower) < upper, upper, -lower)
    return np.stack([np.zeros(number), b * radius * np.cos(angle), c * radius * np.sin(angle)], axis=1)


def _interior_points(number: int, mean: float, axes: SemiAxes, border: Layers, random: np.random.Generator) -> Float64:
    """Points spread evenly over the interior, at least half a compartment away from the layers."""
    a = axes[0]
    edge = 0.15 * np.cbrt(mean)
    inner = max(0.6 * border.inner, border.inner - edge / float(np.mean(axes)))
    back = min(border.retromammary + edge, 0.8 * inner * a)
    rows = np.empty((0, 3))
    while len(rows) < number:
        points = inner * _ellipsoid_points(4 * number, axes, random)
        rows = np.concatenate([rows, points[points[:, 0] > back]])
    return rows[:number]


@njit(cache=True, inline="always")  # type: ignore[misc]
def _squared_distance(p: Float64, q: Float64) -> float:
    return float((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@njit(cache=True)  # type: ignore[misc]
def _farthest(
    candidates: Float64, radius: Float64, apart: Float64, small: NDArray[np.bool_], placed: Float64,
    placed_radius: Float64,
) -> Float64:  # fmt: skip
    """One place (n, 3) per seed out of ``candidates`` (n, m, 3): the one farthest from its nearest neighbour.

    Distances count in units of the sum of both radii; between two small seeds, of both ``apart``.
    placed, placed_radius: seeds of other regions that already stand.
    """
    n, m, _ = candidates.shape
    chosen = np.empty((n, 3))
    for s in range(n):
        best = -1.0
        for c in range(m):
            nearest = 1e30
            for p in range(len(placed)):
                gap = _squared_distance(candidates[s, c], placed[p])
                nearest = min(nearest, gap / (radius[s] + placed_radius[p]) ** 2)
            for p in range(s):
                gap = _squared_distance(candidates[s, c], chosen[p])
                reach = apart[s] + apart[p] if small[s] and small[p] else radius[s] + radius[p]
                nearest = min(nearest, gap / reach**2)
            if nearest > best:
                best = nearest
                for axis in range(3):
                    chosen[s, axis] = candidates[s, c, axis]
    return chosen


def _normal(axes: SemiAxes, points: Float64) -> Float64:
    """Unit normals (n, 3) of the similar ellipsoids through the points."""
    a, b, upper, lower = axes
    c = np.where(points[:, 2] > 0, upper, lower)
    gradient = points / np.stack([np.full(len(points), a), np.full(len(points), b), c], axis=1) ** 2
    gradient[:, 0] += 1e-9
    normal: Float64 = gradient / np.linalg.norm(gradient, axis=1)[:, None]
    return normal


def _metrics(
    radius: Float64, half_thickness: Float64 | None, normal: Float64, spec: CompartmentSpec, random: np.random.Generator
) -> Float64:
    """S = V' diag(1/k^2, 1/(k r1)^2, 1/(k r2)^2) V with k^3 r1 r2 = radius^3, the first axis along the normal."""
    n = len(radius)
    largest = spec.max_axis_ratio
    if half_thickness is None:
        ratio = 1.0 + (largest - 1.0) * random.random((n, 2)) ** 2
    else:
        flatness = (radius / np.maximum(half_thickness, 1e-6)) ** 1.5
        ratio = flatness[:, None] * np.exp(0.2 * random.normal(size=(n, 1)) * np.array([[1.0, -1.0]]))
        ratio = np.clip(ratio, 1.0, largest)
    k = radius / np.cbrt(ratio[:, 0] * ratio[:, 1])
    helper = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(normal, u)
    turn = 2 * math.pi * random.random((n, 1))
    u, v = np.cos(turn) * u + np.sin(turn) * v, np.cos(turn) * v - np.sin(turn) * u
    frame = np.stack([normal, u, v], axis=1)
    weight = 1.0 / (k[:, None] * np.concatenate([np.ones((n, 1)), ratio], axis=1)) ** 2
    metrics: Float64 = np.einsum("nai,na,naj->nij", frame, weight, frame)
    return metrics
