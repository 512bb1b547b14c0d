"""Fractal modulation of the compartments' borders: a displacement with which the cells are looked up.

A point x gets the label of x + w(x). w is fractal (fBm): octaves of smooth noise, each of half the wavelength and half
the strength of the one before, independent along x, y and z. It is given at the nodes of a regular lattice and linear
between them, so its range over any box is that of the nodes around the box, and the bounds of the cells stay exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit
from simcore.phantom.outline import SemiAxes
from simcore.phantom.rows import LANES, PX, PY, PZ
from simcore.phantom.spec import TextureSpec

CELLS_PER_BUMP = 2
"""Cells of the noise over a bump: a bump is half a wave, and cubic splines pass nothing shorter than two cells."""
CLIP = 2.5
"""The largest displacement in units of its standard deviation; the noise, nearly Gaussian, is cut off there."""
_SPLINE_POWER = 151 / 315
"""Mean of the sum of squares of the four weights of a cubic B-spline: what is left of the variance, per axis."""


class Texture(NamedTuple):
    """A displacement on a lattice; no nodes where there is none.

    field:  float32 (3, nz, ny, nx), along x, y and z, mm.
    corner: float32 (3,), (x, y, z) of node [0, 0, 0], mm, breast frame.
    pitch:  distance of the nodes, mm.
    """

    field: NDArray[np.float32]
    corner: NDArray[np.float32]
    pitch: np.float32


PLAIN = Texture(np.zeros((3, 0, 0, 0), np.float32), np.zeros(3, np.float32), np.float32(1.0))
"""No displacement."""


def texture(spec: TextureSpec, axes: SemiAxes, random: np.random.Generator) -> Texture:
    """The displacement of ``spec`` over a breast of semi-axes ``axes``; the same for any voxel size."""
    if spec.amplitude_mm == 0:
        return PLAIN
    depth, half_width, upper, lower = axes
    cell = spec.scale_mm / CELLS_PER_BUMP
    pitch = cell / 2 ** (spec.octaves - 1)
    low = np.floor(np.array([0.0, -half_width, -lower]) / pitch) - 1
    high = np.ceil(np.array([depth, half_width, upper]) / pitch) + 1
    positions = [pitch * np.arange(first, last + 1) for first, last in zip(low, high, strict=True)]
    total = np.zeros((3, *(len(p) for p in reversed(positions))))
    variance = 0.0
    for octave in range(spec.octaves):
        strength = 0.5**octave
        total += strength * _smooth_noise(positions, cell / 2**octave, random)
        variance += strength**2 * _SPLINE_POWER**3
    field = np.clip(total * (spec.amplitude_mm / CLIP / math.sqrt(variance)), -spec.amplitude_mm, spec.amplitude_mm)
    return Texture(field.astype(np.float32), (low * pitch).astype(np.float32), np.float32(pitch))


def _smooth_noise(
    positions: list[NDArray[np.float64]], cell_mm: float, random: np.random.Generator
) -> NDArray[np.float64]:
    """Gaussian noise on a cubic lattice of edge ``cell_mm`` with a random offset, as coefficients of a cubic B-spline.

    positions: along x, y and z, mm. returns: (3, nz, ny, nx), three independent fields.
    """
    offset = random.random(3)
    places = [p / cell_mm + shift for p, shift in zip(positions, offset, strict=True)]
    first = [math.floor(p[0]) - 1 for p in places]
    counts = [math.floor(p[-1]) + 3 - f for p, f in zip(places, first, strict=True)]
    noise = random.normal(size=(3, *reversed(counts)))
    for axis, (place, start) in enumerate(zip(places, first, strict=True)):
        noise = _interpolated(noise, 3 - axis, place - start)
    return noise


def _interpolated(values: NDArray[np.float64], axis: int, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cubic B-spline with coefficients ``values`` along one axis at ``place`` (in cells, at least 1)."""
    cell = np.floor(place).astype(np.int64)
    t = place - cell
    weights = np.stack(
        [(1 - t) ** 3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6, t**3 / 6]
    )
    before, after = values.shape[:axis], values.shape[axis + 1 :]
    result = np.empty((math.prod(before), len(place), math.prod(after)))
    _spline(values.reshape(len(result), -1, result.shape[2]), cell - 1, weights, result)
    return result.reshape(*before, len(place), *after)


@njit(cache=True)
def _spline(
    values: NDArray[np.float64], first: NDArray[np.int64], weights: NDArray[np.float64], result: NDArray[np.float64]
) -> None:
    """result[a, m, b] = sum over n of weights[n, m] values[a, first[m] + n, b]."""
    for a in range(result.shape[0]):
        for m in range(result.shape[1]):
            f = first[m]
            w0, w1, w2, w3 = weights[0, m], weights[1, m], weights[2, m], weights[3, m]
            for b in range(result.shape[2]):
                low = w0 * values[a, f, b] + w1 * values[a, f + 1, b]
                result[a, m, b] = low + w2 * values[a, f + 2, b] + w3 * values[a, f + 3, b]


@njit(cache=True, error_model="numpy", inline="always")
def _node(position, corner, pitch, count):  # type: ignore[no-untyped-def]
    """(node below, share of the node above) of a coordinate; beyond the lattice as at its border."""
    place = min(max((position - corner) / pitch, np.float32(0)), np.float32(count - 1))
    below = min(int(place), count - 2)
    return below, place - np.float32(below)


@njit(cache=True, error_model="numpy")
def displaced(texture, x, y, z):  # type: ignore[no-untyped-def]
    """The point (x, y, z) with its displacement, mm."""
    field, corner, pitch = texture.field, texture.corner, texture.pitch
    if field.shape[1] == 0:
        return x, y, z
    k, u = _node(z, corner[2], pitch, field.shape[1])
    j, v = _node(y, corner[1], pitch, field.shape[2])
    i, w = _node(x, corner[0], pitch, field.shape[3])
    one = np.float32(1)
    return (
        x + _trilinear(field[0], k, j, i, u, v, w, one),
        y + _trilinear(field[1], k, j, i, u, v, w, one),
        z + _trilinear(field[2], k, j, i, u, v, w, one),
    )


@njit(cache=True, error_model="numpy", inline="always")
def _trilinear(f, k, j, i, u, v, w, one):  # type: ignore[no-untyped-def]
    low = (one - v) * ((one - w) * f[k, j, i] + w * f[k, j, i + 1])
    low += v * ((one - w) * f[k, j + 1, i] + w * f[k, j + 1, i + 1])
    high = (one - v) * ((one - w) * f[k + 1, j, i] + w * f[k + 1, j, i + 1])
    high += v * ((one - w) * f[k + 1, j + 1, i] + w * f[k + 1, j + 1, i + 1])
    return (one - u) * low + u * high


@njit(cache=True, error_model="numpy")
def displaced_box(texture, cx, cy, cz, hx, hy, hz):  # type: ignore[no-untyped-def]
    """(centre x, y, z, half extents x, y, z) of a box that holds all displaced points of the given box."""
    field, corner, pitch = texture.field, texture.corner, texture.pitch
    if field.shape[1] == 0:
        return cx, cy, cz, hx, hy, hz
    k0, k1 = _node(cz - hz, corner[2], pitch, field.shape[1])[0], _node(cz + hz, corner[2], pitch, field.shape[1])[0]
    j0, j1 = _node(cy - hy, corner[1], pitch, field.shape[2])[0], _node(cy + hy, corner[1], pitch, field.shape[2])[0]
    i0, i1 = _node(cx - hx, corner[0], pitch, field.shape[3])[0], _node(cx + hx, corner[0], pitch, field.shape[3])[0]
    low_x = low_y = low_z = np.float32(np.inf)
    high_x = high_y = high_z = np.float32(-np.inf)
    for k in range(k0, k1 + 2):
        for j in range(j0, j1 + 2):
            for i in range(i0, i1 + 2):
                low_x, high_x = min(low_x, field[0, k, j, i]), max(high_x, field[0, k, j, i])
                low_y, high_y = min(low_y, field[1, k, j, i]), max(high_y, field[1, k, j, i])
                low_z, high_z = min(low_z, field[2, k, j, i]), max(high_z, field[2, k, j, i])
    half = np.float32(0.5)
    return (
        cx + half * (low_x + high_x), cy + half * (low_y + high_y), cz + half * (low_z + high_z),
        hx + half * (high_x - low_x), hy + half * (high_y - low_y), hz + half * (high_z - low_z),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def displace_row(texture, x0, y, z, step, lane):  # type: ignore[no-untyped-def]
    """Leaves the displaced points of LANES voxels along x from x0 in lane[PX:], lane[PY:] and lane[PZ:]."""
    field, corner, pitch = texture.field, texture.corner, texture.pitch
    k, u = _node(z, corner[2], pitch, field.shape[1])
    j, v = _node(y, corner[1], pitch, field.shape[2])
    one = np.float32(1)
    w00, w01, w10, w11 = (one - u) * (one - v), (one - u) * v, u * (one - v), u * v
    for axis, offset, start in ((0, PX, x0), (1, PY, y), (2, PZ, z)):
        f = field[axis]
        node = -1
        low = high = np.float32(0)
        for n in range(LANES):
            x = x0 + np.float32(n) * step
            i, w = _node(x, corner[0], pitch, field.shape[3])
            if i != node:
                low = w00 * f[k, j, i] + w01 * f[k, j + 1, i] + w10 * f[k + 1, j, i] + w11 * f[k + 1, j + 1, i]
                i += 1
                high = w00 * f[k, j, i] + w01 * f[k, j + 1, i] + w10 * f[k + 1, j, i] + w11 * f[k + 1, j + 1, i]
                node = i - 1
            lane[offset + n] = (x if axis == 0 else start) + low + w * (high - low)
