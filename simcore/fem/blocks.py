"""Matrices in 4x4 blocks: in single precision one cache line and sixteen vector lanes each.

A block (4, 4) and a row of it (4,) are vectors of ``simcore.simd``, of either precision, whose sums may be taken in any
order. Arrays are C-contiguous.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from simcore.simd.vector import Signature, Vector, read, shuffled, write


@intrinsic  # type: ignore[untyped-decorator]
def block_at(typing: Any, blocks: Any, k: Any) -> Signature:
    """blocks[k] of blocks (m, 4, 4)."""
    return _element(Vector(blocks.dtype, 16, fast=True), blocks, k)


@intrinsic  # type: ignore[untyped-decorator]
def row_at(typing: Any, x: Any, a: Any) -> Signature:
    """x[a] of x (n, 4)."""
    return _element(Vector(x.dtype, 4, fast=True), x, a)


@intrinsic  # type: ignore[untyped-decorator]
def row_of(typing: Any, like: Any, first: Any, second: Any, third: Any, fourth: Any) -> Signature:
    """The row of these numbers, in the precision of the array ``like``."""
    kind = Vector(like.dtype, 4, fast=True)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        row = ir.Constant(kind.llvm, ir.Undefined)
        for lane, (value, source) in enumerate(zip(values[1:], signature.args[1:], strict=True)):
            number = context.cast(builder, value, source, like.dtype)
            row = builder.insert_element(row, number, ir.Constant(ir.IntType(32), lane))
        return row

    return kind(like, first, second, third, fourth), generate


@intrinsic  # type: ignore[untyped-decorator]
def in_rows(typing: Any, row: Any) -> Signature:
    """The block each of whose four rows is ``row``."""
    return _spread(row, [j for _ in range(4) for j in range(4)])


@intrinsic  # type: ignore[untyped-decorator]
def in_columns(typing: Any, row: Any) -> Signature:
    """The block each of whose four columns is ``row``."""
    return _spread(row, [i for i in range(4) for _ in range(4)])


@intrinsic  # type: ignore[untyped-decorator]
def on_diagonal(typing: Any, row: Any) -> Signature:
    """The block with ``row`` on its diagonal and 0 elsewhere."""
    return _spread(row, [i if i == j else 4 for i in range(4) for j in range(4)], ir.Constant(row.llvm, [0.0] * 4))


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
        place = _place(context, builder, values[1], a, value)
        return write(context, builder, (values[2], value), (values[0], y), place)

    return types.void(y, a, value), generate


@intrinsic  # type: ignore[untyped-decorator]
def add(typing: Any, y: Any, a: Any, value: Any) -> Signature:
    """y[a] += value: a row in y (n, 4), or a block in y (m, 4, 4)."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _place(context, builder, values[1], a, value)
        before = read(context, builder, value, (values[0], y), place)
        total = builder.fadd(before, values[2], flags=value.flags)
        return write(context, builder, (total, value), (values[0], y), place)

    return types.void(y, a, value), generate


def _element(kind: Vector, array: Any, index: Any) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return read(context, builder, kind, (values[0], array), _place(context, builder, values[1], index, kind))

    return kind(array, index), generate


def _place(context: Any, builder: Any, index: Any, kind_of_index: Any, kind: Vector) -> tuple[Any, Any]:
    """Of the element ``index`` of an array whose elements are as long as ``kind``."""
    number = context.cast(builder, index, kind_of_index, types.intp)
    return builder.mul(number, ir.Constant(ir.IntType(64), kind.count)), types.intp


def _spread(row: Vector, lanes: list[int], other: Any = None) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return shuffled(builder, values[0], lanes, other)

    return row.of(16)(row), generate


def _sum_of_parts(block: Vector, parts: list[list[int]]) -> Signature:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        first, second, third, fourth = (shuffled(builder, values[0], lanes) for lanes in parts)
        low = builder.fadd(first, second, flags=block.flags)
        return builder.fadd(low, builder.fadd(third, fourth, flags=block.flags), flags=block.flags)

    return block.of(4)(block), generate
