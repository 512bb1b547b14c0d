"""Resampling of image rows at evenly spaced positions with vector instructions and no gathers.

Sixteen neighbouring positions with a step near one pixel read a window of few more than sixteen pixels. Position
l of a window that starts at pixel s lies at p + l d from s + l (d = step - 1, small), so

    value[l] = sum over t of hat(p + l d - t) row[s + l + t],   hat(x) = max(0, 1 - |x| / reach),

where each term is one contiguous load. Linear interpolation (reach = 1) has two terms that are not zero; the others
cost less than sixteen scattered loads, and the weights serve eight rows.

The transpose of linear interpolation at positions a + i b is the same sum, with positions (i - a) / b and reach 1 / b.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit
from simcore.simd.vector import LANES, fma, load, magnitude, maximum, minus, negative, ramp, splat, store

FloatArray = NDArray[np.float32]

ROWS = 8
"""Rows resampled together."""


def padded_width(count: int) -> int:
    """``count`` rounded up to whole vectors: the width that ``add_resampled_rows`` fills."""
    return -(-count // LANES) * LANES


def padding(step: float, reach: float = 1.0) -> int:
    """Zeros needed before and after a row that is read with steps of up to ``step`` pixels."""
    return LANES * int(np.ceil(max(step, 1.0))) + 2 * int(np.ceil(reach)) + 2


@njit(cache=True, error_model="numpy")
def add_resampled_rows(
    rows: FloatArray, pad: int, offset: float, step: float, reach: float, totals: FloatArray
) -> None:
    """totals[r, i] += row r weighted with a hat around the position offset + i step; zero beyond the row's ends.

    rows: (ROWS, pad + columns + pad), C order, zero in the padding; pad: ``padding(step, reach)`` or more.
    offset, step: in pixels, 0 is the centre of the first of the ``columns`` pixels; step > 0.
    reach: where the hat is zero, pixels; 1 for linear interpolation.
    totals: (ROWS, padded_width(n)), C order.
    """
    columns = rows.shape[1] - 2 * pad
    drift = (LANES - 1) * (step - 1.0)
    for start in range(0, totals.shape[1], LANES):
        position = offset + start * step
        if position >= columns - 1 + reach or position + (LANES - 1) * step <= -reach:
            continue
        window = int(np.floor(position + min(drift, 0.0) - reach)) + 1
        first = position - window
        taps = int(max(first, first + drift) + reach) + 1
        _add_window(
            rows,
            window + pad,
            totals,
            start,
            np.float32(first),
            np.float32(step - 1.0),
            np.float32(1.0 / reach),
            taps,
        )


@njit(forceinline=True, error_model="numpy")
def _add_window(
    rows: FloatArray,
    window: int,
    totals: FloatArray,
    start: int,
    first: np.float32,
    drift: np.float32,
    slope: np.float32,
    taps: int,
) -> None:
    """totals[r, start + l] += sum over t < taps of hat(first + l drift - t) rows[r, window + l + t], l < 16, r < 8;
    hat(x) = max(0, 1 - slope |x|)."""
    read, write = rows.shape[1], totals.shape[1]
    zero, one = splat(np.float32(0.0), LANES), splat(np.float32(1.0), LANES)
    position = fma(ramp(LANES), splat(drift, LANES), splat(first, LANES))
    falling = negative(splat(slope, LANES))
    a, b = load(totals, start, LANES), load(totals, start + write, LANES)
    c, d = load(totals, start + 2 * write, LANES), load(totals, start + 3 * write, LANES)
    e, f = load(totals, start + 4 * write, LANES), load(totals, start + 5 * write, LANES)
    g, h = load(totals, start + 6 * write, LANES), load(totals, start + 7 * write, LANES)
    for tap in range(taps):
        distance = magnitude(minus(position, splat(np.float32(tap), LANES)))
        hat = maximum(zero, fma(distance, falling, one))
        at = window + tap
        a, b = fma(hat, load(rows, at, LANES), a), fma(hat, load(rows, at + read, LANES), b)
        c, d = fma(hat, load(rows, at + 2 * read, LANES), c), fma(hat, load(rows, at + 3 * read, LANES), d)
        e, f = fma(hat, load(rows, at + 4 * read, LANES), e), fma(hat, load(rows, at + 5 * read, LANES), f)
        g, h = fma(hat, load(rows, at + 6 * read, LANES), g), fma(hat, load(rows, at + 7 * read, LANES), h)
    store(totals, start, a)
    store(totals, start + write, b)
    store(totals, start + 2 * write, c)
    store(totals, start + 3 * write, d)
    store(totals, start + 4 * write, e)
    store(totals, start + 5 * write, f)
    store(totals, start + 6 * write, g)
    store(totals, start + 7 * write, h)
