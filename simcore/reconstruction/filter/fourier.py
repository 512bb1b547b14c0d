"""Columns convolved with a symmetric filter: Fourier transforms of sixteen pairs of columns at a time, in vectors.

The response of a symmetric filter is real, so one complex transform filters two columns, one as the real part and one
as the imaginary part. The forward transform decimates in frequency, in place, and leaves the spectrum in digit-reversed
order; the response is brought into that order, and the inverse transform undoes the passes one by one: nothing is ever
reordered (W. M. Gentleman, G. Sande, AFIPS 29 (1966) 563). The lanes of every vector are columns: a pass runs at the
speed of the second-level cache.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import frozen
from simcore.kernels import njit
from simcore.simd import aligned
from simcore.simd.vector import LANES, fma, load, minus, negative, plus, splat, store, times

FloatArray = NDArray[np.float32]
RADICES = (4, 2, 3, 5)
VALUES_IN_CACHE = 320
"""So many rows of two vectors stay in the first-level cache."""


def _roots(n: int) -> tuple[tuple[np.float32, np.float32], ...]:
    """(cosine, sine) of exp(-2 pi i k / n), k = 1 .. n - 1."""
    return tuple(
        (np.float32(round(np.cos(angle), 15)), np.float32(round(np.sin(angle), 15)))
        for angle in -2 * np.pi / n * np.arange(1, n)
    )


THIRDS, FIFTHS = _roots(3), _roots(5)


@dataclass(frozen=True)
class Passes:
    """How a transform of some length is taken apart.

    radices: int64 (passes,), their product is the length.
    turns:   float32, the twiddle factors exp(-2 pi i j p / n) of every pass, n shrinking from the length by the radix:
             for each j < n / radix the real and the imaginary part for p = 1 .. radix - 1.
    order:   int64 (length,), the frequency that ends at each place.
    """

    radices: NDArray[np.int64]
    turns: FloatArray
    order: NDArray[np.int64]


@cache
def passes_of(length: int) -> Passes:
    """raises: ValueError where ``length`` has a prime factor above 5"""
    radices, left = [], length
    for radix in RADICES:
        while left % radix == 0:
            radices.append(radix)
            left //= radix
    if left != 1:
        raise ValueError(f"a transform of {length} values: only factors 2, 3 and 5 are served")
    turns, n = [np.empty(0)], length
    for radix in radices:
        angle = -2 * np.pi / n * np.outer(np.arange(n // radix), np.arange(1, radix))
        turns.append(np.stack([np.cos(angle), np.sin(angle)], axis=-1).ravel())
        n //= radix
    order = np.zeros(1, np.int64)
    for radix in reversed(radices):
        order = np.concatenate([radix * order + p for p in range(radix)])
    return Passes(frozen(np.array(radices, np.int64)), frozen(np.concatenate(turns).astype(np.float32)), frozen(order))


def convolve_columns(columns: FloatArray, response: FloatArray, length: int, out: FloatArray) -> None:
    """Every column convolved, going round at ``length``.

    columns: (rows, n), rows <= length; beyond them are zeros. Like ``out`` it may be a part of wider rows.
    length: without prime factors above 5.
    response: of a symmetric filter at the frequencies of a real transform, (length // 2 + 1,).
    out: (at most length, n), the first rows of the result.
    """
    passes = passes_of(length)
    places = np.minimum(passes.order, length - passes.order)
    _convolve(columns, passes.radices, passes.turns, response[places] / np.float32(length), out)


@njit(cache=True, nogil=True, error_model="numpy")
def _convolve(
    columns: FloatArray, radices: NDArray[np.int64], turns: FloatArray, response: FloatArray, out: FloatArray
) -> None:
    length, count = len(response), columns.shape[1]
    whole = aligned.row(2 * length * LANES).reshape(2, length, LANES)
    real, imaginary = whole[0], whole[1]
    # Passes over blocks that do not fit into the first-level cache; all others are made block by block.
    large, block, turns_of_large = 0, length, 0
    while block > VALUES_IN_CACHE:
        block //= radices[large]
        turns_of_large += 2 * block * (radices[large] - 1)
        large += 1
    for start in range(0, count, 2 * LANES):
        _read(columns, start, real)
        _read(columns, start + LANES, imaginary)
        _forward(real, imaginary, radices[:large], turns)
        for first in range(0, length, block):
            part = slice(first, first + block)
            _forward(real[part], imaginary[part], radices[large:], turns[turns_of_large:])
            _scale(real[part], response[part])
            _scale(imaginary[part], response[part])
            _back(real[part], imaginary[part], radices[large:], turns[turns_of_large:])
        _back(real, imaginary, radices[:large], turns)
        _write(real, out, start)
        _write(imaginary, out, start + LANES)


@njit(cache=True, nogil=True, error_model="numpy")
def _read(columns: FloatArray, start: int, part: FloatArray) -> None:
    """Columns from ``start`` on into the lanes; zero beyond the last row and column."""
    rows, count = columns.shape
    pitch = columns.strides[0] // columns.itemsize
    part[rows:] = np.float32(0.0)
    if start + LANES <= count:
        for row in range(rows):
            store(part, row * LANES, load(columns, row * pitch + start, LANES))
        return
    part[:rows] = np.float32(0.0)
    for row in range(rows):
        for i in range(count - start):
            part[row, i] = columns[row, start + i]


@njit(cache=True, nogil=True, error_model="numpy")
def _write(part: FloatArray, out: FloatArray, start: int) -> None:
    rows, count = out.shape
    pitch = out.strides[0] // out.itemsize
    if start + LANES <= count:
        for row in range(rows):
            store(out, row * pitch + start, load(part, row * LANES, LANES))
        return
    for row in range(rows):
        for i in range(count - start):
            out[row, start + i] = part[row, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _scale(part: FloatArray, factors: FloatArray) -> None:
    for k in range(len(factors)):
        for i in range(LANES):
            part[k, i] *= factors[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _forward(real: FloatArray, imaginary: FloatArray, radices: NDArray[np.int64], turns: FloatArray) -> None:
    """Pass after pass, each over all blocks of values that belong together."""
    n, at = real.shape[0], 0
    for radix in radices:
        stride = n // radix
        for block in range(0, real.shape[0], n):
            for j in range(stride):
                turn = at + 2 * j * (radix - 1)
                if radix == 4:
                    _forward4(real, imaginary, block + j, stride, turns, turn)
                elif radix == 2:
                    _forward2(real, imaginary, block + j, stride, turns, turn)
                elif radix == 3:
                    _forward3(real, imaginary, block + j, stride, turns, turn)
                else:
                    _forward5(real, imaginary, block + j, stride, turns, turn)
        n = stride
        at += 2 * stride * (radix - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _back(real: FloatArray, imaginary: FloatArray, radices: NDArray[np.int64], turns: FloatArray) -> None:
    """Undoes ``_forward`` but for the product of the radices."""
    stride, at = real.shape[0], 0
    for radix in radices:
        stride //= radix
        at += 2 * stride * (radix - 1)
    for radix in radices[::-1]:
        n = stride * radix
        at -= 2 * stride * (radix - 1)
        for block in range(0, real.shape[0], n):
            for j in range(stride):
                turn = at + 2 * j * (radix - 1)
                if radix == 4:
                    _back4(real, imaginary, block + j, stride, turns, turn)
                elif radix == 2:
                    _back2(real, imaginary, block + j, stride, turns, turn)
                elif radix == 3:
                    _back3(real, imaginary, block + j, stride, turns, turn)
                else:
                    _back5(real, imaginary, block + j, stride, turns, turn)
        stride = n


# Complex vectors are pairs (real, imaginary). LLVM puts everything below into its callers.


@njit(forceinline=True)
def _at(real: FloatArray, imaginary: FloatArray, place: int) -> Any:
    return load(real, place * LANES, LANES), load(imaginary, place * LANES, LANES)


@njit(forceinline=True)
def _put(real: FloatArray, imaginary: FloatArray, place: int, value: Any) -> None:
    store(real, place * LANES, value[0])
    store(imaginary, place * LANES, value[1])


@njit(forceinline=True)
def _sum(one: Any, other: Any) -> Any:
    return plus(one[0], other[0]), plus(one[1], other[1])


@njit(forceinline=True)
def _difference(one: Any, other: Any) -> Any:
    return minus(one[0], other[0]), minus(one[1], other[1])


@njit(forceinline=True)
def _turned(value: Any, cosine: np.float32, sine: np.float32) -> Any:
    """(cosine + i sine) value"""
    c, s = splat(cosine, LANES), splat(sine, LANES)
    return fma(c, value[0], negative(times(s, value[1]))), fma(c, value[1], times(s, value[0]))


@njit(forceinline=True)
def _plus_turned(total: Any, one: Any, turn_one: Any, other: Any, turn_other: Any) -> Any:
    """total + turn_one one + turn_other other; turns: (cosine, sine)"""
    total = _sum(total, _turned(one, turn_one[0], turn_one[1]))
    return _sum(total, _turned(other, turn_other[0], turn_other[1]))


# The transforms of 3, 4 and 5 values; the inverse one of any number has the results 0, n - 1, n - 2, ... of these.


@njit(forceinline=True)
def _three(a: Any, b: Any, c: Any) -> Any:
    return (
        _sum(_sum(a, b), c),
        _plus_turned(a, b, THIRDS[0], c, THIRDS[1]),
        _plus_turned(a, b, THIRDS[1], c, THIRDS[0]),
    )


@njit(forceinline=True)
def _four(a: Any, b: Any, c: Any, d: Any) -> Any:
    even, odd = _sum(a, c), _sum(b, d)
    across, aside = _difference(a, c), _difference(b, d)
    return (
        _sum(even, odd),
        (plus(across[0], aside[1]), minus(across[1], aside[0])),
        _difference(even, odd),
        (minus(across[0], aside[1]), plus(across[1], aside[0])),
    )


@njit(forceinline=True)
def _five(a: Any, b: Any, c: Any, d: Any, e: Any) -> Any:
    one, two, three, four = FIFTHS
    return (
        _sum(_sum(_sum(_sum(a, b), c), d), e),
        _plus_turned(_plus_turned(a, b, one, c, two), d, three, e, four),
        _plus_turned(_plus_turned(a, b, two, c, four), d, one, e, three),
        _plus_turned(_plus_turned(a, b, three, c, one), d, four, e, two),
        _plus_turned(_plus_turned(a, b, four, c, three), d, two, e, one),
    )


# Butterflies: the values at first + q stride, q < radix, transformed in place. Forward: the transform, then the twiddle
# factors from turns[turn] on. Back: their inverses, then the inverse transform.


@njit(forceinline=True)
def _put_turned(real: FloatArray, imaginary: FloatArray, place: int, value: Any, turns: FloatArray, turn: int) -> None:
    _put(real, imaginary, place, _turned(value, turns[turn], turns[turn + 1]))


@njit(forceinline=True)
def _turned_back(real: FloatArray, imaginary: FloatArray, place: int, turns: FloatArray, turn: int) -> Any:
    return _turned(_at(real, imaginary, place), turns[turn], -turns[turn + 1])


@njit(forceinline=True)
def _forward2(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    a, b = _at(real, imaginary, first), _at(real, imaginary, first + stride)
    _put(real, imaginary, first, _sum(a, b))
    _put_turned(real, imaginary, first + stride, _difference(a, b), turns, turn)


@njit(forceinline=True)
def _back2(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    a, b = _at(real, imaginary, first), _turned_back(real, imaginary, first + stride, turns, turn)
    _put(real, imaginary, first, _sum(a, b))
    _put(real, imaginary, first + stride, _difference(a, b))


@njit(forceinline=True)
def _forward3(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    second, third = first + stride, first + 2 * stride
    a, b, c = _three(_at(real, imaginary, first), _at(real, imaginary, second), _at(real, imaginary, third))
    _put(real, imaginary, first, a)
    _put_turned(real, imaginary, second, b, turns, turn)
    _put_turned(real, imaginary, third, c, turns, turn + 2)


@njit(forceinline=True)
def _back3(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    second, third = first + stride, first + 2 * stride
    b = _turned_back(real, imaginary, second, turns, turn)
    c = _turned_back(real, imaginary, third, turns, turn + 2)
    a, c, b = _three(_at(real, imaginary, first), b, c)
    _put(real, imaginary, first, a)
    _put(real, imaginary, second, b)
    _put(real, imaginary, third, c)


@njit(forceinline=True)
def _forward4(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    second, third, fourth = first + stride, first + 2 * stride, first + 3 * stride
    a, b = _at(real, imaginary, first), _at(real, imaginary, second)
    a, b, c, d = _four(a, b, _at(real, imaginary, third), _at(real, imaginary, fourth))
    _put(real, imaginary, first, a)
    _put_turned(real, imaginary, second, b, turns, turn)
    _put_turned(real, imaginary, third, c, turns, turn + 2)
    _put_turned(real, imaginary, fourth, d, turns, turn + 4)


@njit(forceinline=True)
def _back4(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    second, third, fourth = first + stride, first + 2 * stride, first + 3 * stride
    b = _turned_back(real, imaginary, second, turns, turn)
    c = _turned_back(real, imaginary, third, turns, turn + 2)
    d = _turned_back(real, imaginary, fourth, turns, turn + 4)
    a, d, c, b = _four(_at(real, imaginary, first), b, c, d)
    _put(real, imaginary, first, a)
    _put(real, imaginary, second, b)
    _put(real, imaginary, third, c)
    _put(real, imaginary, fourth, d)


@njit(forceinline=True)
def _forward5(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    second, third, fourth, fifth = first + stride, first + 2 * stride, first + 3 * stride, first + 4 * stride
    a, b, c = _at(real, imaginary, first), _at(real, imaginary, second), _at(real, imaginary, third)
    a, b, c, d, e = _five(a, b, c, _at(real, imaginary, fourth), _at(real, imaginary, fifth))
    _put(real, imaginary, first, a)
    _put_turned(real, imaginary, second, b, turns, turn)
    _put_turned(real, imaginary, third, c, turns, turn + 2)
    _put_turned(real, imaginary, fourth, d, turns, turn + 4)
    _put_turned(real, imaginary, fifth, e, turns, turn + 6)


@njit(forceinline=True)
def _back5(real: FloatArray, imaginary: FloatArray, first: int, stride: int, turns: FloatArray, turn: int) -> None:
    second, third, fourth, fifth = first + stride, first + 2 * stride, first + 3 * stride, first + 4 * stride
    b = _turned_back(real, imaginary, second, turns, turn)
    c = _turned_back(real, imaginary, third, turns, turn + 2)
    d = _turned_back(real, imaginary, fourth, turns, turn + 4)
    e = _turned_back(real, imaginary, fifth, turns, turn + 6)
    a, e, d, c, b = _five(_at(real, imaginary, first), b, c, d, e)
    _put(real, imaginary, first, a)
    _put(real, imaginary, second, b)
    _put(real, imaginary, third, c)
    _put(real, imaginary, fourth, d)
    _put(real, imaginary, fifth, e)
