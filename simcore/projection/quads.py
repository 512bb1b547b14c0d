"""Four numbers at a time, for arrays that hold four maps side by side.

numba's compiler finds such vectors in loops over many elements, not in the four steps of one access; so the accesses
that matter are written down as vector instructions, which every processor has or LLVM splits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

QUAD = ir.VectorType(ir.FloatType(), 4)
FLAGS = ("contract", "nsz")


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """To element ``index`` of a contiguous float32 array, as a quad."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), QUAD.as_pointer())


def _load(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    value = builder.load(_pointer(context, builder, kind, array, index))
    value.align = 4
    return value


def _splat(builder: Any, scalar: Any) -> Any:
    undefined = ir.Constant(QUAD, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), 4), [0, 0, 0, 0])
    return builder.shuffle_vector(first, undefined, lanes)


@intrinsic  # type: ignore[untyped-decorator]
def take_two(
    typing: Any, out: Any, v: Any, prefix: Any, entered: Any, before: Any, left: Any, after: Any, b: Any
) -> tuple[Any, Callable[..., Any]]:
    """out[v : v + 4] -= prefix[b : b + 4] + before entered[b : b + 4] + after left[b : b + 4]."""
    signature = types.void(out, types.int64, prefix, entered, types.float32, left, types.float32, types.int64)

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        out_, v_, prefix_, entered_, before_, left_, after_, b_ = values
        total = _load(context, builder, prefix, prefix_, b_)
        for kind, array, part in ((entered, entered_, before_), (left, left_, after_)):
            term = builder.fmul(_load(context, builder, kind, array, b_), _splat(builder, part), flags=FLAGS)
            total = builder.fadd(total, term, flags=FLAGS)
        old = _load(context, builder, out, out_, v_)
        store = builder.store(builder.fsub(old, total, flags=FLAGS), _pointer(context, builder, out, out_, v_))
        store.align = 4
        return context.get_dummy_value()

    return signature, generate


@intrinsic  # type: ignore[untyped-decorator]
def take_one(
    typing: Any, out: Any, v: Any, prefix: Any, step: Any, part: Any, b: Any
) -> tuple[Any, Callable[..., Any]]:
    """out[v : v + 4] -= prefix[b : b + 4] + part step[b : b + 4]."""
    signature = types.void(out, types.int64, prefix, step, types.float32, types.int64)

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        out_, v_, prefix_, step_, part_, b_ = values
        term = builder.fmul(_load(context, builder, step, step_, b_), _splat(builder, part_), flags=FLAGS)
        total = builder.fadd(_load(context, builder, prefix, prefix_, b_), term, flags=FLAGS)
        old = _load(context, builder, out, out_, v_)
        store = builder.store(builder.fsub(old, total, flags=FLAGS), _pointer(context, builder, out, out_, v_))
        store.align = 4
        return context.get_dummy_value()

    return signature, generate


@intrinsic  # type: ignore[untyped-decorator]
def put_difference(
    typing: Any, out: Any, b: Any, table: Any, first: Any, second: Any
) -> tuple[Any, Callable[..., Any]]:
    """out[b : b + 4] = table[first : first + 4] - table[second : second + 4]."""
    signature = types.void(out, types.int64, table, types.int64, types.int64)

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        out_, b_, table_, first_, second_ = values
        one, two = (_load(context, builder, table, table_, index) for index in (first_, second_))
        store = builder.store(builder.fsub(one, two, flags=FLAGS), _pointer(context, builder, out, out_, b_))
        store.align = 4
        return context.get_dummy_value()

    return signature, generate
