"""Matrices in 4x4 blocks: in single precision one cache line and sixteen vector lanes each.

numba's compiler finds vectors in long loops, not in the sixteen steps of one block; so a block in registers (4, 4) and
a row of it (4,) are types of their own here, and what is done with them is written down as LLVM's vector instructions,
which every processor has or LLVM splits. Either precision; arrays are C-contiguous.
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


class _Vector(types.Type):  # type: ignore[misc]
    """``count`` numbers in registers."""

    def __init__(self, element: Any, count: int) -> None:
        super().__init__(name=f"{element}x{count}")
        self.element = element
        self.count = count
        self.llvm = ir.VectorType({types.float32: ir.FloatType(), types.float64: ir.DoubleType()}[element], count)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.llvm)


def empty(*shape: int) -> Singles:
    """float32 array that begins on a cache line, so that no block lies across two."""
    count = int(np.prod(shape))
    room = np.empty(count + LINE_BYTES // 4, np.float32)
    start = -room.ctypes.data % LINE_BYTES // 4
    return room[start : start + count].reshape(shape)


@intrinsic  # type: ignore[untyped-decorator]
def block_at(typing: Any, blocks: Any, k: Any) -> Signature:
    """blocks[k] of blocks (m, 4, 4)."""
    return _load(_Vector(blocks.dtype, 16), blocks, k)


@intrinsic  # type: ignore[untyped-decorator]
def row_at(typing: Any, x: Any, a: Any) -> Signature:
    """x[a] of x (n, 4)."""
    return _load(_Vector(x.dtype, 4), x, a)


@intrinsic  # type: ignore[untyped-decorator]
def row_of(typing: Any, like: Any, first: Any, second: Any, third: Any, fourth: Any) -> Signature:
    """The row of these numbers, in the precision of the array ``like``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        row = ir.Constant(signature.return_type.llvm, ir.Undefined)
        for lane, (value, kind) in enumerate(zip(values[1:], signature.args[1:], strict=True)):
            number = context.cast(builder, value, kind, like.dtype)
            row = builder.insert_element(row, number, ir.Constant(ir.IntType(32), lane))
        return row

    return _Vector(like.dtype, 4)(like, first, second, third, fourth), generate


@intrinsic  # type: ignore[untyped-decorator]
def in_rows(typing: Any, row: Any) -> Signature:
    """The block each of whose four rows is ``row``."""
    return _shuffle(_Vector(row.element, 16), row, [j for _ in range(4) for j in range(4)])


@intrinsic  # type: ignore[untyped-decorator]
def in_columns(typing: Any, row: Any) -> Signature:
    """The block each of whose four columns is ``row``."""
    return _shuffle(_Vector(row.element, 16), row, [i for i in range(4) for _ in range(4)])


@intrinsic  # type: ignore[untyped-decorator]
def on_diagonal(typing: Any, row: Any) -> Signature:
    """The block with ``row`` on its diagonal and 0 elsewhere."""
    kind = _Vector(row.element, 16)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        zero = ir.Constant(row.llvm, [0.0] * 4)
        return _shuffled(builder, values[0], [i if i == j else 4 for i in range(4) for j in range(4)], zero)

    return kind(row), generate


@intrinsic  # type: ignore[untyped-decorator]
def times(typing: Any, one: Any, other: Any) -> Signature:
    """Element by element."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fmul(*values, flags=_FLAGS)

    return one(one, one), generate


@intrinsic  # type: ignore[untyped-decorator]
def plus(typing: Any, one: Any, other: Any) -> Signature:
    """Element by element."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fadd(*values, flags=_FLAGS)

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
    return _sum_of_parts(block, [[4 * i + j for j in range(4)] for i in range(4)])


@intrinsic  # type: ignore[untyped-decorator]
def sum_of_columns(typing: Any, block: Any) -> Signature:
    """The row whose component i is the sum over j of block[i, j]."""
    return _sum_of_parts(block, [[4 * i + j for i in range(4)] for j in range(4)])


@intrinsic  # type: ignore[untyped-decorator]
def put(typing: Any, y: Any, a: Any, value: Any) -> Signature:
    """y[a] = value: a row in y (n, 4), or a block in y (m, 4, 4)."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = _pointer(context, builder, signature, values, value)
        builder.store(values[2], pointer, align=_alignment(value))
        return context.get_dummy_value()

    return types.void(y, a, value), generate


@intrinsic  # type: ignore[untyped-decorator]
def add(typing: Any, y: Any, a: Any, value: Any) -> Signature:
    """y[a] += value: a row in y (n, 4), or a block in y (m, 4, 4)."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = _pointer(context, builder, signature, values, value)
        before = builder.load(pointer, align=_alignment(value))
        builder.store(builder.fadd(before, values[2], flags=_FLAGS), pointer, align=_alignment(value))
        return context.get_dummy_value()

    return types.void(y, a, value), generate


def _load(kind: _Vector, array: Any, index: Any) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(_pointer(context, builder, signature, values, kind), align=_alignment(kind))

    return kind(array, index), generate


def _alignment(kind: _Vector) -> int:
    """Bytes that every array has: those of one number."""
    return int(kind.element.bitwidth) // 8


def _pointer(context: Any, builder: Any, signature: Any, values: Any, kind: _Vector) -> Any:
    """To element ``values[1]`` of the C-contiguous array ``values[0]``, whose elements are as long as ``kind``."""
    array = context.make_array(signature.args[0])(context, builder, values[0])
    index = context.cast(builder, values[1], signature.args[1], types.intp)
    first = builder.mul(index, ir.Constant(ir.IntType(64), kind.count))
    return builder.bitcast(builder.gep(array.data, [first]), kind.llvm.as_pointer())


def _shuffle(kind: _Vector, row: Any, lanes: list[int]) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _shuffled(builder, values[0], lanes)

    return kind(row), generate


def _shuffled(builder: Any, value: Any, lanes: list[int], other: Any = None) -> Any:
    """Numbers of ``value``, and after them those of ``other``, by their places."""
    index = ir.IntType(32)
    mask = ir.Constant(ir.VectorType(index, len(lanes)), [ir.Constant(index, lane) for lane in lanes])
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined) if other is None else other, mask)


def _sum_of_parts(block: _Vector, parts: list[list[int]]) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        first, second, third, fourth = (_shuffled(builder, values[0], lanes) for lanes in parts)
        low = builder.fadd(first, second, flags=_FLAGS)
        return builder.fadd(low, builder.fadd(third, fourth, flags=_FLAGS), flags=_FLAGS)

    return _Vector(block.element, 4)(block), generate
