"""Columns convolved with a symmetric filter: Fourier transforms of sixteen pairs of columns at a time, in vectors.

The response of a symmetric filter is real, so one complex transform filters two columns, one as the real part and one
as the imaginary part. The forward transform decimates in frequency, in place, and leaves the spectrum in digit-reversed
order; the response is brought into that order, and the inverse transform undoes the passes one by one: nothing is ever
reordered (W. M. Gentleman, G. Sande, AFIPS 29 (1966) 563). Every butterfly is written out in vectors whose lanes are
columns, as in ``lanes``: a pass runs at the speed of the second-level cache.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from simcore.core.artifacts import frozen
from simcore.core.vectors import LANES, VECTOR, splat

FloatArray = NDArray[np.float32]
RADICES = (4, 2, 3, 5)
VALUES_IN_CACHE = 320
"""So many rows of two vectors stay in the first-level cache."""

_INDEX = ir.IntType(64)


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
    memory = np.empty(2 * length * LANES + LANES, np.float32)
    shift = (-memory.ctypes.data % 64) // 4
    whole = memory[shift : shift + 2 * length * LANES].reshape(2, length, LANES)
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
            _move(columns, row * pitch + start, part, row * LANES)
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
            _move(part, row * LANES, out, row * pitch + start)
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


@intrinsic  # type: ignore[untyped-decorator]
def _move(typing: Any, source: Any, start: Any, target: Any, place: Any) -> tuple[Any, Any]:
    """LANES neighbouring values from one array to another; places are counted from their first values."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source_value, start, target_value, place = arguments
        pointers = [
            builder.bitcast(
                builder.gep(context.make_array(kind)(context, builder, value).data, [at]), VECTOR.as_pointer()
            )
            for kind, value, at in (
                (signature.args[0], source_value, start),
                (signature.args[2], target_value, place),
            )
        ]
        builder.store(builder.load(pointers[0], align=4), pointers[1], align=4)
        return context.get_dummy_value()

    return types.void(source, types.int64, target, types.int64), generate


def _butterfly(radix: int, forward: bool) -> Any:
    """(real, imaginary, first, stride, turns, turn): the values at first + q stride, q < radix, transformed in place.

    forward: the transform, then the twiddle factors from turns[turn] on; else their inverses, in the inverse order.
    """

    @intrinsic  # type: ignore[untyped-decorator]
    def butterfly(
        typing: Any, real: Any, imaginary: Any, first: Any, stride: Any, turns: Any, turn: Any
    ) -> tuple[Any, Any]:
        signature = types.void(real, imaginary, types.int64, types.int64, turns, types.int64)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            real_value, imaginary_value, first, stride, turns_value, turn = arguments
            memory = [
                context.make_array(kind)(context, builder, value).data
                for kind, value in zip(signature.args[:2], (real_value, imaginary_value), strict=True)
            ]
            factors = context.make_array(signature.args[4])(context, builder, turns_value).data
            one = _Complex(builder)
            places = [
                builder.mul(builder.add(first, builder.mul(stride, _INDEX(q))), _INDEX(LANES)) for q in range(radix)
            ]
            pointers = [
                [builder.bitcast(builder.gep(m, [place]), VECTOR.as_pointer()) for m in memory] for place in places
            ]
            values = [tuple(builder.load(p, align=64) for p in pair) for pair in pointers]

            def turned(value: Any, p: int) -> Any:
                cosine, sine = (
                    splat(builder, builder.load(builder.gep(factors, [builder.add(turn, _INDEX(2 * (p - 1) + part))])))
                    for part in range(2)
                )
                return one.times(value, cosine, sine if forward else builder.fneg(sine))

            if not forward:
                values = values[:1] + [turned(v, p) for p, v in enumerate(values) if p > 0]
            values = [one.sum_of_turned(values, -p if forward else p) for p in range(radix)]
            if forward:
                values = values[:1] + [turned(v, p) for p, v in enumerate(values) if p > 0]
            for pair, value in zip(pointers, values, strict=True):
                for pointer, part in zip(pair, value, strict=True):
                    builder.store(part, pointer, align=64)
            return context.get_dummy_value()

        return signature, generate

    return butterfly


class _Complex:
    """Arithmetic of pairs (real, imaginary) of vectors."""

    def __init__(self, builder: Any) -> None:
        self.builder = builder

    def times(self, value: Any, cosine: Any, sine: Any) -> Any:
        b = self.builder
        real, imaginary = value
        return (
            self.multiply_add(cosine, real, b.fneg(b.fmul(sine, imaginary))),
            self.multiply_add(cosine, imaginary, b.fmul(sine, real)),
        )

    def multiply_add(self, x: Any, y: Any, z: Any) -> Any:
        kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
        name = f"llvm.fmuladd.v{LANES}f32"
        function = self.builder.module.globals.get(name) or ir.Function(self.builder.module, kind, name)
        return self.builder.call(function, [x, y, z])

    def sum_of_turned(self, values: list[Any], steps: int) -> Any:
        """sum over q of values[q] exp(2 pi i q steps / len(values))"""
        radix = len(values)
        if radix % 2 == 0:  # the sums and differences of opposite values serve several results
            half = radix // 2
            join = self.plus if steps % 2 == 0 else self.minus
            values = [join(values[q], values[q + half]) for q in range(half)]
        total = values[0]
        for q, value in enumerate(values[1:], 1):
            total = self.plus(total, self.by_constant(value, np.exp(2j * np.pi * q * steps / radix)))
        return total

    def plus(self, x: Any, y: Any) -> Any:
        return tuple(self.builder.fadd(a, b) for a, b in zip(x, y, strict=True))

    def minus(self, x: Any, y: Any) -> Any:
        return tuple(self.builder.fsub(a, b) for a, b in zip(x, y, strict=True))

    def by_constant(self, value: Any, factor: complex) -> Any:
        real, imaginary = value
        cosine, sine = round(factor.real, 15), round(factor.imag, 15)
        if (cosine, sine) == (1.0, 0.0):
            return value
        if cosine == 0.0 and abs(sine) == 1.0:
            return (self.builder.fneg(imaginary), real) if sine > 0 else (imaginary, self.builder.fneg(real))
        constants = (ir.Constant(VECTOR, [float(np.float32(c))] * LANES) for c in (cosine, sine))
        return self.times(value, *constants)


_forward2, _forward3, _forward4, _forward5 = (_butterfly(radix, True) for radix in (2, 3, 4, 5))
_back2, _back3, _back4, _back5 = (_butterfly(radix, False) for radix in (2, 3, 4, 5))
