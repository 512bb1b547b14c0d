"""Loops over the pixels of a view. Each runs on one thread; views run beside one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.detection.normals import BLOCK, fill_row
from simcore.kernels import njit

FloatArray = NDArray[np.float32]
Key = NDArray[np.uint64]


@njit(cache=True, nogil=True, error_model="numpy")
def pad(view: FloatArray, out: FloatArray) -> None:
    """The view in the first rows and columns of ``out``; beyond, as a transform goes round, its edges go on."""
    (ny, nx), (rows, columns) = view.shape, out.shape
    for j in range(rows):
        source = j if j < ny else (ny - 1 if j < (ny + rows) // 2 else 0)
        middle = (nx + columns) // 2
        for i in range(nx):
            out[j, i] = view[source, i]
        for i in range(nx, middle):
            out[j, i] = view[source, nx - 1]
        for i in range(middle, columns):
            out[j, i] = view[source, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def times_normals(variance: FloatArray, key: Key) -> None:
    """Each number becomes its root times a normal number, in place."""
    rows, columns = variance.shape
    line = np.empty(-(-columns // BLOCK) * BLOCK, np.float32)
    for j in range(rows):
        fill_row(key, j, line)
        row = variance[j]
        for i in range(columns):
            row[i] = np.sqrt(row[i]) * line[i]


@njit(cache=True, nogil=True, error_model="numpy")
def add_white(charge: FloatArray, variance: FloatArray, key: Key) -> None:
    """Noise without correlation, root of the variance, added to the charge."""
    rows, columns = charge.shape
    line = np.empty(-(-columns // BLOCK) * BLOCK, np.float32)
    for j in range(rows):
        fill_row(key, j, line)
        row, spread = charge[j], variance[j]
        for i in range(columns):
            row[i] += np.sqrt(spread[i]) * line[i]


@njit(cache=True, nogil=True, error_model="numpy")
def filter_signal(spectrum: NDArray[np.complex64], along: NDArray[np.complex64], response: FloatArray) -> None:
    """spectrum *= along[:, None] response, in place."""
    rows, columns = spectrum.shape
    for j in range(rows):
        for i in range(columns):
            spectrum[j, i] = spectrum[j, i] * (along[j] * response[j, i])


@njit(cache=True, nogil=True, error_model="numpy")
def add_filtered(spectrum: NDArray[np.complex64], noise: NDArray[np.complex64], response: FloatArray) -> None:
    """spectrum += noise response, in place."""
    rows, columns = spectrum.shape
    for j in range(rows):
        for i in range(columns):
            spectrum[j, i] = spectrum[j, i] + noise[j, i] * response[j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def read_out(
    charge: FloatArray,
    earlier: FloatArray,
    lag: float,
    electronic_keV: float,
    key: Key,
    gain: FloatArray,
    dead: NDArray[np.bool_],
    scale: float,
    offset: float,
    limit: float,
    raw: NDArray[np.uint16],
) -> tuple[int, int, float]:
    """Charge to raw numbers: round(offset + scale gain (charge + lag earlier + electronic noise)), between 0 and the
    limit; dead pixels give the offset.

    earlier: the charge of the view before, or of no rows. electronic_keV: 0 for none.
    returns: pixels at the limit, pixels at 0, sum of the numbers; dead ones left out.
    """
    ny, nx = charge.shape
    line = np.zeros(-(-nx // BLOCK) * BLOCK, np.float32)
    value = np.empty(nx, np.float32)
    factor, sigma = np.float32(scale), np.float32(electronic_keV)
    full, empty, total = 0, 0, 0.0
    for j in range(ny):
        if electronic_keV > 0.0:
            fill_row(key, j, line)
        row, gains, numbers = charge[j], gain[j], raw[j]
        for i in range(nx):
            value[i] = row[i] + sigma * line[i]
        if earlier.shape[0] > 0:
            before = earlier[j]
            for i in range(nx):
                value[i] += np.float32(lag) * before[i]
        for i in range(nx):
            value[i] = np.floor(value[i] * (factor * gains[i]) + np.float32(offset + 0.5))
        for i in range(nx):
            numbers[i] = np.uint16(min(max(value[i], np.float32(0.0)), np.float32(limit)))
        row_full, row_empty, row_total = 0, 0, 0
        for i in range(nx):
            lives = not dead[j, i]
            row_full += lives and value[i] >= limit
            row_empty += lives and value[i] < 0.0
            row_total += numbers[i] if lives else 0
            numbers[i] = numbers[i] if lives else np.uint16(offset + 0.5)
        full, empty, total = full + row_full, empty + row_empty, total + row_total
    return full, empty, total


@njit(cache=True, nogil=True, error_model="numpy")
def flatten(
    raw: NDArray[np.uint16],
    flat: FloatArray,
    known: FloatArray,
    dead: NDArray[np.bool_],
    interpolate: bool,
    scale: float,
    offset: float,
    out: NDArray[np.uint16],
) -> tuple[int, int]:
    """round(scale (raw - offset) / (flat known)), between 0 and 65535; dead pixels by their neighbours in the row.

    returns: pixels above the largest number, pixels below 0.
    """
    ny, nx = raw.shape
    value = np.empty(nx, np.float32)
    factor, zero = np.float32(scale), np.float32(offset)
    above, below = 0, 0
    for j in range(ny):
        numbers, open_field, gains = raw[j], flat[j], known[j]
        for i in range(nx):
            value[i] = (np.float32(numbers[i]) - zero) * factor / (open_field[i] * gains[i])
        if interpolate:
            _bridge(value, dead[j])
        row_above, row_below = 0, 0
        for i in range(nx):
            rounded = np.floor(value[i] + np.float32(0.5))
            row_above += rounded > np.float32(65535.0)
            row_below += rounded < np.float32(0.0)
            out[j, i] = np.uint16(min(max(rounded, np.float32(0.0)), np.float32(65535.0)))
        above, below = above + row_above, below + row_below
    return above, below


@njit(nogil=True, error_model="numpy")
def _bridge(value: FloatArray, dead: NDArray[np.bool_]) -> None:
    """Dead pixels of a row by the nearest living ones on either side; of a row without any they stay."""
    nx = len(value)
    for i in range(nx):
        if not dead[i]:
            continue
        left, right = i - 1, i + 1
        while left >= 0 and dead[left]:
            left -= 1
        while right < nx and dead[right]:
            right += 1
        if left >= 0 and right < nx:
            value[i] = (value[left] + value[right]) / np.float32(2.0)
        elif left >= 0:
            value[i] = value[left]
        elif right < nx:
            value[i] = value[right]
