"""Modulation transfer function from a slanted edge, a line or a small bead.

Slanted edge: E. Samei, M. J. Flynn, D. A. Reimann, "A method for measuring the presampled MTF of digital radiographic
systems using an edge test device", Med. Phys. 25 (1998) 102. An edge that crosses the pixel rows at a few degrees is
sampled finer than the pixels, so the result is not folded at their Nyquist frequency.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
OVERSAMPLING = 8
"""Bins of the edge spread function per pixel."""


def line_spread_mtf(line: NDArray[np.generic], step_mm: float) -> tuple[FloatArray, FloatArray]:
    """|Fourier transform| of a line spread function over its value at 0: (frequency [1/mm], MTF).

    raises: ValueError where the line spread function has no area (e.g. of a system without a mean value, such as a
        reconstruction from a limited angle: use ``peak_normalised``).
    """
    frequency, modulus = _modulus(line, step_mm)
    if not modulus[0] > 1e-12 * modulus.max():
        raise ValueError("the line spread function has no area, so its MTF has no value 1 at frequency 0")
    return frequency, modulus / modulus[0]


def peak_normalised(line: NDArray[np.generic], step_mm: float) -> tuple[FloatArray, FloatArray]:
    """As ``line_spread_mtf``, over its maximum: for systems that suppress low frequencies."""
    frequency, modulus = _modulus(line, step_mm)
    return frequency, modulus / modulus.max()


def _modulus(line: NDArray[np.generic], step_mm: float) -> tuple[FloatArray, FloatArray]:
    values = np.asarray(line, np.float64)
    return scipy.fft.rfftfreq(len(values), step_mm), np.abs(scipy.fft.rfft(values))


def frequency_at(frequency: FloatArray, mtf: FloatArray, level: float = 0.5) -> float:
    """First frequency beyond the maximum of the MTF where it falls to ``level``, linearly interpolated; infinite
    where it does not."""
    start = int(np.argmax(mtf))
    below = np.flatnonzero(mtf[start:] <= level)
    if len(below) == 0:
        return math.inf
    i = start + int(below[0])
    if i == 0:
        return float(frequency[0])
    part = (mtf[i - 1] - level) / (mtf[i - 1] - mtf[i])
    return float(frequency[i - 1] + part * (frequency[i] - frequency[i - 1]))


def slanted_edge_mtf(
    image: NDArray[np.generic], pixel_mm: float, half_width_mm: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """MTF across a straight edge that crosses every row: (frequency [1/mm], MTF) up to twice the Nyquist frequency.

    image: (ny, nx) line integrals or any signal that is linear in what is imaged; values rise or fall along x by the
        edge, which leans by about 1 to 10 degrees against the columns.
    half_width_mm: how far from the edge the spread function is followed; as far as it lies in all rows where not given.
    raises: ValueError where the edge runs along the columns, or too near to the sides of the image.
    """
    values = np.asarray(image, np.float64)
    offset, slope = _edge_line(values)
    rows, columns = values.shape
    # Distance of pixel centres from the edge line, in pixels.
    lean = 1.0 / math.hypot(1.0, slope)
    distance = (np.arange(columns) - (offset + slope * np.arange(rows))[:, None]) * lean
    if abs(slope) * rows < 1.0:
        raise ValueError(f"the edge moves by {abs(slope) * rows:.2f} pixels over the image; at least 1 is needed")
    reach = min(-float(distance[:, 0].max()), float(distance[:, -1].min()))
    reach = reach if half_width_mm is None else min(reach, half_width_mm / pixel_mm)
    bins = int(reach * OVERSAMPLING)
    if bins < 2 * OVERSAMPLING:
        raise ValueError(f"only {reach:.1f} pixels lie on both sides of the edge; at least 2 are needed")
    edge = _binned(distance, values, bins)
    line = np.diff(edge)
    line *= np.hanning(len(line) + 2)[1:-1]
    frequency, mtf = line_spread_mtf(line, pixel_mm / OVERSAMPLING)
    # Binning averages over one bin, and the difference of neighbours is a derivative times a sinc of one bin.
    mtf = mtf / np.sinc(frequency * pixel_mm / OVERSAMPLING) ** 2
    band = frequency <= 1.0 / pixel_mm
    return frequency[band], mtf[band]


def _edge_line(values: FloatArray) -> tuple[float, float]:
    """Column of the edge in row 0 and its change from row to row, pixels: a line through the centroids of the
    derivative of every row, fitted twice, the second time near the first line alone."""
    derivative = np.abs(np.diff(values, axis=1))
    rows, columns = derivative.shape
    position = np.arange(columns) + 0.5
    weights = derivative
    offset, slope = 0.0, 0.0
    for attempt in range(2):
        area = weights.sum(axis=1)
        if not np.all(area > 0):
            raise ValueError("some rows hold no edge")
        slope, offset = np.polyfit(np.arange(rows), weights @ position / area, 1)
        if attempt == 0:
            line = (offset + slope * np.arange(rows))[:, None]
            weights = np.where(np.abs(position - line) <= max(8.0, 0.1 * columns), derivative, 0.0)
    return float(offset), float(slope)


def _binned(distance: FloatArray, values: FloatArray, bins: int) -> FloatArray:
    """Edge spread function: mean value in ``bins`` bins on each side of the edge; empty bins are interpolated."""
    index = np.floor(distance * OVERSAMPLING).astype(np.int64) + bins
    inside = (index >= 0) & (index < 2 * bins)
    count = np.bincount(index[inside], minlength=2 * bins)
    total = np.bincount(index[inside], values[inside], 2 * bins)
    filled = np.flatnonzero(count)
    return np.asarray(np.interp(np.arange(2 * bins), filled, total[filled] / count[filled]))
