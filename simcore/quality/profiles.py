"""How far a small object spreads: profiles, their width, and the artefact spread function.

Artefact spread function (T. Wu, R. H. Moore, E. A. Rafferty, D. B. Kopans, "A comparison of reconstruction algorithms
for breast tomosynthesis", Med. Phys. 31 (2004) 2636): contrast of the object's shadow in slice z over its contrast in
its own slice.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Volume
from simcore.core.grid import Grid, Point

FloatArray = NDArray[np.float64]


def cut_out(volume: Volume, low: Point, high: Point) -> tuple[NDArray[np.float32], Grid]:
    """Attenuation [1/mm], float32 (nz, ny, nx), of the voxels whose centres lie between two corners (x, y, z), mm.

    raises: ValueError where no voxel lies there.
    """
    grid = volume.grid
    bounds = []
    for axis, lower, upper in zip("xyz", low, high, strict=True):
        inside = np.flatnonzero((grid.centres(axis) >= lower) & (grid.centres(axis) <= upper))
        if len(inside) == 0:
            raise ValueError(f"no voxel lies between {axis} = {lower:g} and {upper:g} mm")
        bounds.append((int(inside[0]), int(inside[-1]) + 1))
    (x0, x1), (y0, y1), (z0, z1) = bounds
    values = np.float32(volume.slope) * volume.data[z0:z1, y0:y1, x0:x1] + np.float32(volume.intercept)
    cut = Grid((z1 - z0, y1 - y0, x1 - x0), grid.spacing, grid.corner)
    return np.asarray(values), cut.moved(*(start * s for start, s in zip((x0, y0, z0), grid.spacing, strict=True)))


def full_width_at_half_maximum(positions: NDArray[np.float64], values: NDArray[np.generic]) -> float:
    """Width of the largest peak between its two half-maximum points, linearly interpolated; unit of ``positions``.

    positions: increasing. The base line is 0. Infinite where the profile ends before it falls to the half.
    """
    profile = np.asarray(values, np.float64)
    peak = int(np.argmax(profile))
    half = profile[peak] / 2
    if not half > 0:
        raise ValueError(f"the profile has no peak: its maximum is {profile[peak]:g}")
    edges = []
    for step, end in ((-1, -1), (1, len(profile))):
        i = peak
        while i != end and profile[i] > half:
            i += step
        if i == end:
            return math.inf
        inner = i - step
        part = (profile[inner] - half) / (profile[inner] - profile[i])
        edges.append(float(positions[inner] + part * (positions[i] - positions[inner])))
    return edges[1] - edges[0]


def artefact_spread(
    values: NDArray[np.float32],
    grid: Grid,
    centre: Point,
    radius_mm: float,
    background_mm: tuple[float, float],
    source: Point | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Artefact spread function of a round object: (z - z of the object [mm], ASF), each float64 (nz,).

    values: float32 (nz, ny, nx). radius_mm: of the area the object's value is averaged over.
    background_mm: inner and outer radius of the ring that gives the background of each slice.
    source: where the shadow in other slices is followed to, (x, y, z) mm, as a rule the focal spot of the central
        view; straight up where not given.
    raises: ValueError where the object has no contrast in its own slice, or its shadow leaves the values.
    """
    heights = grid.centres("z") - centre[2]
    contrast = np.empty(len(heights))
    for k, height in enumerate(heights):
        along = 0.0 if source is None else height / (source[2] - centre[2])
        shift_x, shift_y = (0.0, 0.0) if source is None else (source[0] - centre[0], source[1] - centre[1])
        distance = distances(grid, centre[0] + along * shift_x, centre[1] + along * shift_y)
        ring = (distance >= background_mm[0]) & (distance <= background_mm[1])
        if not (distance.min() <= radius_mm and ring.any()):
            raise ValueError(f"the shadow at {height:+.1f} mm lies outside the values: cut out more around the object")
        contrast[k] = values[k][distance <= radius_mm].mean() - values[k][ring].mean()
    own = contrast[int(np.argmin(np.abs(heights)))]
    if not own > 0:
        raise ValueError(f"the object at {centre} has no contrast in its own slice: {own:g}")
    return heights, contrast / own


def in_plane_profile(
    values: NDArray[np.float32], grid: Grid, centre: Point, axis: str, half_length_mm: float, background_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Profile through an object in its own slice along "x" or "y": (position - centre [mm], value - background).

    The background is the mean of the profile farther than ``background_mm`` from the centre.
    """
    k = int(np.argmin(np.abs(grid.centres("z") - centre[2])))
    j = int(np.argmin(np.abs(grid.centres("y") - centre[1])))
    i = int(np.argmin(np.abs(grid.centres("x") - centre[0])))
    line = values[k, j] if axis == "x" else values[k, :, i]
    positions = grid.centres(axis) - centre["xyz".index(axis)]
    near = np.abs(positions) <= half_length_mm
    outside = near & (np.abs(positions) >= background_mm)
    return positions[near], np.asarray(line[near] - line[outside].mean(), np.float64)


def distances(grid: Grid, x: float, y: float) -> FloatArray:
    """In-plane distance of every voxel centre from (x, y), float64 (ny, nx), mm."""
    return np.asarray(np.hypot(grid.centres("y")[:, None] - y, grid.centres("x") - x))
