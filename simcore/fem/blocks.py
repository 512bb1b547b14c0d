"""Symmetric matrices in 4x4 blocks of single precision, one cache line and sixteen vector lanes each.

numba's compiler finds vectors in long loops, not in the sixteen steps of one block; so a block in registers is a type of
its own here, and what is done with it is written down as LLVM's vector instructions, which every processor has or LLVM
splits. Vectors are (n, 4), float32: three components and one number more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Signature = tuple[Any, Callable[..., Any]]

LINE_BYTES = 64
_FLAGS = ("fast",)
_FLOAT, _INDEX = ir.FloatType(), ir.IntType(64)
_ROW, _BLOCK = ir.VectorType(_FLOAT, 4), ir.VectorType(_FLOAT, 16)


class _Vector(types.Type):  # type: ignore[misc]
    """A value in registers."""

    def __init__(self, name: str, vector: Any) -> None:
        super().__init__(name=name)
        self.vector = vector


ROW, BLOCK = _Vector("Row", _ROW), _Vector("Block", _BLOCK)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


def empty(*shape: int) -> Singles:
    """float32 array that begins on a cache line, so that no block lies across two."""
    count = int(np.prod(shape))
    room = np.empty(count + LINE_BYTES // 4, np.float32)
    start = -room.ctypes.data % LINE_BYTES // 4
    return room[start : start + count].reshape(shape)


@intrinsic  # type: ignore[untyped-decorator]
def block_at(typing: Any, blocks: Any, k: Any) -> Signature:
    """blocks[k] of blocks (m, 4, 4)."""
    return _loading(BLOCK, blocks, k, lambda builder, value: value)


@intrinsic  # type: ignore[untyped-decorator]
def row_at(typing: Any, x: Any, a: Any) -> Signature:
    """x[a] of x (n, 4)."""
    return _loading(ROW, x, a, lambda builder, value: value)


@intrinsic  # type: ignore[untyped-decorator]
def as_rows(typing: Any, x: Any, a: Any) -> Signature:
    """The block each of whose four rows is x[a], (n, 4)."""
    return _loading(BLOCK, x, a, lambda builder, row: _shuffled(builder, row, [0, 1, 2, 3] * 4), loaded=ROW)


@intrinsic  # type: ignore[untyped-decorator]
def as_columns(typing: Any, x: Any, a: Any) -> Signature:
    """The block each of whose four columns is x[a], (n, 4)."""
    lanes = [i for i in range(4) for _ in range(4)]
    return _loading(BLOCK, x, a, lambda builder, row: _shuffled(builder, row, lanes), loaded=ROW)


@intrinsic  # type: ignore[untyped-decorator]
def four_times(typing: Any, number: Any) -> Signature:
    """The row of four equal numbers."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        first = builder.insert_element(ir.Constant(_ROW, ir.Undefined), values[0], ir.Constant(ir.IntType(32), 0))
        return _shuffled(builder, first, [0, 0, 0, 0])

    return ROW(types.float32), generate


@intrinsic  # type: ignore[untyped-decorator]
def times(typing: Any, one: Any, other: Any) -> Signature:
    """Element by element."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fmul(*values, flags=_FLAGS)

    return one(one, one), generate


@intrinsic  # type: ignore[untyped-decorator]
def times_plus(typing: Any, one: Any, other: Any, sum_: Any) -> Signature:
    """one * other + sum_, element by element."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        product = builder.fmul(values[0], values[1], flags=_FLAGS)
        return builder.fadd(product, values[2], flags=_FLAGS)

    return one(one, one, one), generate


@intrinsic  # type: ignore[untyped-decorator]
def sum_of_rows(typing: Any, block: Any) -> Signature:
    """The row whose component j is the sum over i of block[i, j]."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _sum_of_parts(builder, values[0], [[4 * i + j for j in range(4)] for i in range(4)])

    return ROW(BLOCK), generate


@intrinsic  # type: ignore[untyped-decorator]
def sum_of_columns(typing: Any, block: Any) -> Signature:
    """The row whose component i is the sum over j of block[i, j]."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _sum_of_parts(builder, values[0], [[4 * i + j for i in range(4)] for j in range(4)])

    return ROW(BLOCK), generate


@intrinsic  # type: ignore[untyped-decorator]
def put(typing: Any, y: Any, a: Any, row: Any) -> Signature:
    """y[a] = row, in y (n, 4)."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.store(values[2], _pointer(context, builder, signature, values, _ROW), align=4)
        return context.get_dummy_value()

    return types.void(y, a, ROW), generate


@intrinsic  # type: ignore[untyped-decorator]
def add(typing: Any, y: Any, a: Any, row: Any) -> Signature:
    """y[a] += row, in y (n, 4)."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = _pointer(context, builder, signature, values, _ROW)
        builder.store(builder.fadd(builder.load(pointer, align=4), values[2], flags=_FLAGS), pointer, align=4)
        return context.get_dummy_value()

    return types.void(y, a, ROW), generate


def _loading(
    kind: _Vector, array: Any, index: Any, then: Callable[[Any, Any], Any], loaded: _Vector | None = None
) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = _pointer(context, builder, signature, values, (loaded or kind).vector)
        return then(builder, builder.load(pointer, align=4))

    return kind(array, index), generate


def _pointer(context: Any, builder: Any, signature: Any, values: Any, vector: Any) -> Any:
    """To element ``values[1]`` of the C-contiguous float32 array ``values[0]``, elements as long as ``vector``."""
    array = context.make_array(signature.args[0])(context, builder, values[0])
    index = context.cast(builder, values[1], signature.args[1], types.intp)
    first = builder.mul(index, ir.Constant(_INDEX, vector.count))
    return builder.bitcast(builder.gep(array.data, [first]), vector.as_pointer())


def _shuffled(builder: Any, value: Any, lanes: list[int]) -> Any:
    index = ir.IntType(32)
    mask = ir.Constant(ir.VectorType(index, len(lanes)), [ir.Constant(index, lane) for lane in lanes])
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), mask)


def _sum_of_parts(builder: Any, block: Any, parts: list[list[int]]) -> Any:
    first, second, third, fourth = (_shuffled(builder, block, lanes) for lanes in parts)
    low = builder.fadd(first, second, flags=_FLAGS)
    return builder.fadd(low, builder.fadd(third, fourth, flags=_FLAGS), flags=_FLAGS)
