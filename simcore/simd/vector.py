"""A vector of numbers: one value in registers, with loads, stores and arithmetic lane by lane.

    total = load(sums, place, LANES)                                # sums[place : place + LANES]
    store(sums, place, fma(splat(part, LANES), weights, total))     # ... = part weights + total

Arrays: float32 or float64, of any shape; places count numbers from the first one on, and what is read or written there
must lie one after the other. Nothing is checked. Widths are constants of the kernel; LLVM serves any.

Arithmetic is exact to the order that it is written in, but that ``fma`` rounds once where the processor can (as every
one of the last ten years can). Vectors that are loaded as ``fast`` may be added in any order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.core.types.misc import unliteral
from numba.extending import intrinsic, models, register_model

Signature = tuple[Any, Callable[..., Any]]

LANES = 16
"""Of a vector of single precision that fills a cache line."""

_NAMES = {types.float32: "f32", types.float64: "f64"}


class Vector(types.Type):  # type: ignore[misc]
    """``count`` numbers in registers. fast: their sums may be taken in any order."""

    def __init__(self, element: Any, count: int, fast: bool = False) -> None:
        super().__init__(name=f"{element}x{count}{' fast' if fast else ''}")
        self.element = element
        self.count = count
        self.fast = fast
        self.flags = ("fast",) if fast else ()
        self.llvm = ir.VectorType({types.float32: ir.FloatType(), types.float64: ir.DoubleType()}[element], count)
        self.bytes_of_element = int(element.bitwidth) // 8

    def of(self, count: int) -> Vector:
        """The same with another number of lanes."""
        return Vector(self.element, count, self.fast)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.llvm)


# What operations generate


def read(context: Any, builder: Any, kind: Vector, array: tuple[Any, Any], place: tuple[Any, Any]) -> Any:
    """The vector at ``place`` of ``array``, both (value, type)."""
    return builder.load(_pointer(context, builder, kind, array, place), align=kind.bytes_of_element)


def write(context: Any, builder: Any, value: tuple[Any, Vector], array: tuple[Any, Any], place: tuple[Any, Any]) -> Any:
    """Puts a vector there; as ``read``."""
    pointer = _pointer(context, builder, value[1], array, place)
    builder.store(value[0], pointer, align=value[1].bytes_of_element)
    return context.get_dummy_value()


def _pointer(context: Any, builder: Any, kind: Vector, array: tuple[Any, Any], place: tuple[Any, Any]) -> Any:
    data = context.make_array(array[1])(context, builder, array[0]).data
    index = context.cast(builder, place[0], place[1], types.intp)
    return builder.bitcast(builder.gep(data, [index]), kind.llvm.as_pointer())


def shuffled(builder: Any, value: Any, lanes: list[int], other: Any = None) -> Any:
    """Numbers of ``value``, and after them those of ``other``, by their places."""
    index = ir.IntType(32)
    mask = ir.Constant(ir.VectorType(index, len(lanes)), [ir.Constant(index, lane) for lane in lanes])
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined) if other is None else other, mask)


def _call(builder: Any, kind: Vector, name: str, values: list[Any]) -> Any:
    """An intrinsic function of LLVM."""
    function = ir.FunctionType(kind.llvm, [kind.llvm] * len(values))
    name = f"llvm.{name}.v{kind.count}{_NAMES[kind.element]}"
    return builder.call(cgutils.get_or_insert_function(builder.module, function, name), values)


def multiply_add(builder: Any, kind: Vector, values: Any) -> Any:
    one, other, sum_ = values
    if kind.fast:
        return builder.fadd(builder.fmul(one, other, flags=kind.flags), sum_, flags=kind.flags)
    return _call(builder, kind, "fmuladd", [one, other, sum_])


# Loads and stores


@intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
def load(typing: Any, array: Any, place: Any, width: Any) -> Signature:
    """array[place : place + width]."""
    return _load(array, place, width, fast=False)


@intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
def load_fast(typing: Any, array: Any, place: Any, width: Any) -> Signature:
    """array[place : place + width], a ``fast`` vector."""
    return _load(array, place, width, fast=True)


def _load(array: Any, place: Any, width: Any, fast: bool) -> Signature:
    kind = Vector(array.dtype, _constant(width), fast)
    place = unliteral(place)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return read(context, builder, kind, (values[0], array), (values[1], place))

    return kind(array, place, width), generate


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, place: Any, value: Any) -> Signature:
    """array[place : place + width] = value."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return write(context, builder, (values[2], value), (values[0], array), (values[1], place))

    return types.void(array, place, value), generate


@intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
def splat(typing: Any, number: Any, width: Any) -> Signature:
    """``number``, a float, in every lane."""
    number = unliteral(number)
    kind = Vector(number, _constant(width))

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        first = builder.insert_element(ir.Constant(kind.llvm, ir.Undefined), values[0], ir.IntType(32)(0))
        return shuffled(builder, first, [0] * kind.count)

    return kind(number, width), generate


@intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
def ramp(typing: Any, width: Any) -> Signature:
    """0, 1, 2, ... in single precision."""
    kind = Vector(types.float32, _constant(width))

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return ir.Constant(kind.llvm, [float(n) for n in range(kind.count)])

    return kind(width), generate


def _constant(width: Any) -> int:
    if not isinstance(width, types.IntegerLiteral):
        raise TypingError("the width of a vector must be a constant")
    return int(width.literal_value)


# Arithmetic, lane by lane


def _same(*kinds: Any) -> Vector:
    if not (isinstance(kinds[0], Vector) and all(k == kinds[0] for k in kinds)):
        raise TypingError(f"vectors of one kind: {', '.join(map(str, kinds))}")
    return kinds[0]


@intrinsic  # type: ignore[untyped-decorator]
def fma(typing: Any, one: Any, other: Any, sum_: Any) -> Signature:
    """one * other + sum_"""
    kind = _same(one, other, sum_)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return multiply_add(builder, kind, values)

    return kind(kind, kind, kind), generate


@intrinsic  # type: ignore[untyped-decorator]
def times(typing: Any, one: Any, other: Any) -> Signature:
    """one * other"""
    return _operation("fmul", one, other)


@intrinsic  # type: ignore[untyped-decorator]
def plus(typing: Any, one: Any, other: Any) -> Signature:
    """one + other"""
    return _operation("fadd", one, other)


@intrinsic  # type: ignore[untyped-decorator]
def minus(typing: Any, one: Any, other: Any) -> Signature:
    """one - other"""
    return _operation("fsub", one, other)


@intrinsic  # type: ignore[untyped-decorator]
def negative(typing: Any, one: Any) -> Signature:
    """-one"""
    return _operation("fneg", one)


def _operation(name: str, *kinds: Any) -> Signature:
    kind = _same(*kinds)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return getattr(builder, name)(*values, flags=kind.flags)

    return kind(*kinds), generate


@intrinsic  # type: ignore[untyped-decorator]
def minimum(typing: Any, one: Any, other: Any) -> Signature:
    """The smaller of two numbers; the other one where one is not a number."""
    return _function("minnum", one, other)


@intrinsic  # type: ignore[untyped-decorator]
def maximum(typing: Any, one: Any, other: Any) -> Signature:
    """The larger of two numbers; the other one where one is not a number."""
    return _function("maxnum", one, other)


@intrinsic  # type: ignore[untyped-decorator]
def magnitude(typing: Any, one: Any) -> Signature:
    """|one|"""
    return _function("fabs", one)


def _function(name: str, *kinds: Any) -> Signature:
    kind = _same(*kinds)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _call(builder, kind, name, list(values))

    return kind(*kinds), generate


@intrinsic  # type: ignore[untyped-decorator]
def word_at(typing: Any, labels: Any, place: Any) -> Signature:
    """labels[place : place + 8] of bytes, as one number: whether eight labels are as eight others in one comparison."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(labels)(context, builder, values[0]).data
        index = context.cast(builder, values[1], place, types.intp)
        return builder.load(builder.bitcast(builder.gep(data, [index]), ir.IntType(64).as_pointer()), align=1)

    return types.uint64(labels, place), generate
