"""Compiled parts of the iterative corrections.

Row sums (how many slices a ray crosses within the volume) and column sums (how much of a voxel the rays of a view see)
are products of a factor along y and one along x, for the interpolation is: no array of them is kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit, prange
from simcore.reconstruction.operators.lanes import ROWS
from simcore.reconstruction.operators.slice_kernels import Gathering, gather_rows

FloatArray = NDArray[np.float32]

LEAST_SUM = np.float32(1e-3)
"""Rays and voxels that are barely met say nothing."""

Lengths = tuple[FloatArray, FloatArray, float]
"""What lengths of rays in a slice follow from: (y / height)^2 and (x / height)^2 of pixels from the source's foot, its
height above the detector; distance of slices, mm."""


@njit(cache=True)
def ray_sums(offset: float, step: float, rays: int, voxels: int) -> FloatArray:
    """Sum of the interpolation weights along one axis of every ray, float32 (rays,): 1 inside, falling to 0 outside."""
    sums = np.empty(rays, np.float32)
    for i in range(rays):
        position = offset + i * step
        sums[i] = max(0.0, min(1.0, min(position + 1.0, voxels - position)))
    return sums


@njit(cache=True)
def voxel_sums(offset: float, step: float, rays: int, voxels: int) -> FloatArray:
    """Sum of the interpolation weights along one axis that every voxel has in all rays, float32 (voxels,)."""
    sums = np.zeros(voxels, np.float32)
    for i in range(rays):
        position = offset + i * step
        lower = int(np.floor(position))
        part = position - lower
        if 0 <= lower < voxels:
            sums[lower] += 1.0 - part
        if 0 <= lower + 1 < voxels:
            sums[lower + 1] += part
    return sums


@njit(cache=True, parallel=True, error_model="numpy")
def algebraic_residuals(
    crossed: FloatArray, integrals: FloatArray, sums_y: FloatArray, sums_x: FloatArray, lengths: Lengths
) -> NDArray[np.float64]:
    """Turns what a view's rays cross into what is missing, per unit of row sum, in place.

    crossed: float32 (ny, nx), sums of the volume's interpolated slices. integrals: the same shape, measured.
    sums_y, sums_x: ``ray_sums`` of every slice, float32 (nz, ny) and (nz, nx).
    returns: (ny,), the sums of (missing)^2 / row sum. (Added up elsewhere: compiled sums depend on threads.)
    """
    ny = crossed.shape[0]
    squares = np.zeros(ny)
    for j in prange(ny):
        row_sums = _row_sums(sums_y, sums_x, j)
        row_lengths = _row_lengths(lengths[0][j], lengths[1], np.float32(lengths[2]))
        squares[j] = _residual_row(crossed[j], integrals[j], row_sums, row_lengths)
    return squares


@njit(cache=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def _residual_row(
    crossed: FloatArray, integrals: FloatArray, row_sums: FloatArray, row_lengths: FloatArray
) -> np.float32:
    squares = np.float32(0.0)
    for i in range(len(crossed)):
        missing = integrals[i] / row_lengths[i] - crossed[i]
        # Nothing was measured where it is not a number.
        known = (missing == missing) & (row_sums[i] > LEAST_SUM)
        share = missing / row_sums[i] if known else np.float32(0.0)
        squares += share * share * row_sums[i]
        crossed[i] = share
    return squares


@njit(cache=True, parallel=True, error_model="numpy")
def likelihood_terms(
    crossed: FloatArray,
    integrals: FloatArray,
    sums_y: FloatArray,
    sums_x: FloatArray,
    lengths: Lengths,
    curvature: FloatArray,
) -> NDArray[np.float64]:
    """Turns what a view's rays cross into the slope of the likelihood, in place, and fills the curvature of its
    paraboloidal surrogate; both per quantum in the open beam, float32 (ny, nx).

    returns: (ny,), how far the likelihood is from that of the measured values themselves, per quantum in the open beam.
    """
    ny, nx = crossed.shape
    distances = np.zeros(ny)
    for j in prange(ny):
        row_sums = _row_sums(sums_y, sums_x, j)
        row_lengths = _row_lengths(lengths[0][j], lengths[1], np.float32(lengths[2]))
        distance = 0.0
        for i in range(nx):
            length = float(row_lengths[i])
            measured = float(integrals[j, i])
            integral = length * crossed[j, i]
            if measured != measured or row_sums[i] <= LEAST_SUM:
                crossed[j, i] = np.float32(0.0)
                curvature[j, i] = np.float32(0.0)
                continue
            expected, counted = np.exp(-integral), np.exp(-measured)
            distance += expected - counted + counted * (integral - measured)
            bend = 1.0 - integral * 2.0 / 3.0
            if abs(integral) > 1e-3:
                bend = 2.0 * (1.0 - expected - integral * expected) / (integral * integral)
            crossed[j, i] = length * (expected - counted)
            curvature[j, i] = length * length * row_sums[i] * bend
        distances[j] = distance
    return distances


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _row_lengths(square_y: np.float32, squares_x: FloatArray, slice_mm: np.float32) -> FloatArray:
    result = np.empty_like(squares_x)
    for i in range(len(result)):
        result[i] = slice_mm * np.sqrt(np.float32(1.0) + square_y + squares_x[i])
    return result


@njit(cache=True, error_model="numpy")
def _row_sums(sums_y: FloatArray, sums_x: FloatArray, j: int) -> FloatArray:
    total = np.zeros(sums_x.shape[1], np.float32)
    for z in range(sums_x.shape[0]):
        _add_scaled(sums_x[z], sums_y[z, j], total)
    return total


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _add_scaled(row: FloatArray, factor: np.float32, total: FloatArray) -> None:
    if factor != 0.0:
        for i in range(len(total)):
            total[i] += factor * row[i]


@njit(cache=True, parallel=True, error_model="numpy")
def correct_by_sums(
    shares: FloatArray,
    gathering: Gathering,
    sums_y: FloatArray,
    sums_x: FloatArray,
    factor: np.float32,
    floor: np.float32,
    volume: FloatArray,
) -> None:
    """volume = max(floor, volume + factor (transpose of shares) / column sums), in place.

    shares: float32 (views, ny, nx). sums_y: ``voxel_sums`` of the groups' views added up, float32 (groups, nz, ny);
    sums_x: of every group, float32 (groups, nz, nx).
    """
    nz, ny, nx = volume.shape
    pad, width = gathering[4], gathering[5]
    for block in prange((ny + ROWS - 1) // ROWS):
        y0 = block * ROWS
        count = min(ROWS, ny - y0)
        summed = np.zeros((ROWS, shares.shape[2] + 2 * pad), np.float32)
        total = np.empty((ROWS, width), np.float32)
        weights = np.empty(nx, np.float32)
        for z in range(nz):
            gather_rows(shares, gathering, z, y0, count, summed, total)
            for r in range(count):
                weights[:] = np.float32(0.0)
                for group in range(sums_x.shape[0]):
                    _add_scaled(sums_x[group, z], sums_y[group, z, y0 + r], weights)
                _correct_row(total[r], weights, factor, LEAST_SUM, floor, volume[z, y0 + r])


@njit(cache=True, parallel=True, error_model="numpy")
def correct_by_curvature(
    slopes: FloatArray,
    curvatures: FloatArray,
    gathering: Gathering,
    factor: np.float32,
    floor: np.float32,
    volume: FloatArray,
) -> None:
    """volume = max(floor, volume + factor (transpose of slopes) / (transpose of curvatures)), in place; both
    float32 (views, ny, nx)."""
    nz, ny, _ = volume.shape
    pad, width = gathering[4], gathering[5]
    for block in prange((ny + ROWS - 1) // ROWS):
        y0 = block * ROWS
        count = min(ROWS, ny - y0)
        summed = np.zeros((ROWS, slopes.shape[2] + 2 * pad), np.float32)
        slope = np.empty((ROWS, width), np.float32)
        curvature = np.empty((ROWS, width), np.float32)
        for z in range(nz):
            gather_rows(slopes, gathering, z, y0, count, summed, slope)
            gather_rows(curvatures, gathering, z, y0, count, summed, curvature)
            for r in range(count):
                _correct_row(slope[r], curvature[r], factor, np.float32(0.0), floor, volume[z, y0 + r])


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
def _correct_row(
    numerator: FloatArray,
    denominator: FloatArray,
    factor: np.float32,
    least: np.float32,
    floor: np.float32,
    row: FloatArray,
) -> None:
    for i in range(len(row)):
        change = numerator[i] / denominator[i]
        change = change if denominator[i] > least else np.float32(0.0)
        row[i] = max(row[i] + factor * change, floor)
