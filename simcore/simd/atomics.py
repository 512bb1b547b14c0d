"""Numbers that several threads change: each operation is whole, and orders what is written before and read after it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

Signature = tuple[Any, Callable[..., Any]]


@intrinsic  # type: ignore[untyped-decorator]
def add(typing: Any, numbers: Any, k: Any, count: Any) -> Signature:
    """numbers[k] += count. numbers: int64."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        more = context.cast(builder, values[2], signature.args[2], types.int64)
        builder.atomic_rmw("add", _pointer(context, builder, signature, values), more, "acq_rel")
        return context.get_dummy_value()

    return types.void(numbers, k, count), generate


@intrinsic  # type: ignore[untyped-decorator]
def replace(typing: Any, numbers: Any, k: Any, old: Any, new: Any) -> Signature:
    """numbers[k] = new if it is old, and whether it was."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pair = [context.cast(builder, values[i], signature.args[i], types.int64) for i in (2, 3)]
        pointer = _pointer(context, builder, signature, values)
        return builder.extract_value(builder.cmpxchg(pointer, *pair, "acq_rel", "acquire"), 1)

    return types.boolean(numbers, k, old, new), generate


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, numbers: Any, k: Any) -> Signature:
    """numbers[k], with all that was written before it was."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load_atomic(_pointer(context, builder, signature, values), "acquire", 8)

    return types.int64(numbers, k), generate


def _pointer(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, values[0])
    return builder.gep(array.data, [context.cast(builder, values[1], signature.args[1], types.intp)])
