"""Threads that share a computation of many short rounds without waking and sleeping.

A round is a fixed number of parts that may be computed at the same time; its parts begin when those of the round before
are finished. Whoever is free takes the next ticket, one number for round and part; what a part computes does not depend
on who computes it, so one thread or many, the result is the same. Waiting is spinning. Where a wait is long the machine
has given a processor to somebody else: then the team breaks up, and the caller goes on alone.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numba
import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

Result = TypeVar("Result")
Signature = tuple[Any, Callable[..., Any]]

_TAKEN, _FINISHED, _ALONE = 0, 8, 16
"""On cache lines of their own."""
LEAVE = -1


def tickets() -> NDArray[np.int64]:
    """For one computation: int64 (24,)."""
    return np.zeros(24, np.int64)


def together(work: Callable[[bool], Result], members: int) -> Result:
    """``work`` called by at most ``members`` threads and no more than numba may use; what it returned to the caller.

    work: told whether it is the caller's; releases the interpreter lock; ends when the last round is finished, or its
    ``begin`` says LEAVE.
    """
    others = min(members, numba.get_num_threads()) - 1
    if others < 1:
        return work(True)
    with ThreadPoolExecutor(others) as pool:
        started = [pool.submit(work, False) for _ in range(others)]
        result = work(True)
        for other in started:
            other.result()
    return result


@njit(cache=True, nogil=True)
def begin(numbers: NDArray[np.int64], parts: int, patience: int, callers: bool) -> tuple[int, int]:
    """(round, part) to compute, once the round before is finished; (LEAVE, 0) never to the caller's own thread.

    patience: how often to look before a wait is a long one; a look takes about a nanosecond.
    """
    looks = 0
    while True:
        if not callers and _load(numbers, _ALONE) > 0:
            return LEAVE, 0
        ticket = _load(numbers, _TAKEN)
        if _load(numbers, _FINISHED) >= ticket - ticket % parts and _replace(numbers, _TAKEN, ticket, ticket + 1):
            return ticket // parts, ticket % parts
        looks += 1
        if looks == patience:
            _add(numbers, _ALONE, 1)


@njit(cache=True, nogil=True)
def finish(numbers: NDArray[np.int64]) -> None:
    """The part is computed."""
    _add(numbers, _FINISHED, 1)


@intrinsic  # type: ignore[untyped-decorator]
def _add(typing: Any, numbers: Any, k: Any, count: Any) -> Signature:
    """numbers[k] += count"""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        more = context.cast(builder, values[2], signature.args[2], types.int64)
        builder.atomic_rmw("add", _pointer(context, builder, signature, values), more, "acq_rel")
        return context.get_dummy_value()

    return types.void(numbers, k, count), generate


@intrinsic  # type: ignore[untyped-decorator]
def _replace(typing: Any, numbers: Any, k: Any, old: Any, new: Any) -> Signature:
    """numbers[k] = new if it is old, and whether it was."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pair = [context.cast(builder, values[i], signature.args[i], types.int64) for i in (2, 3)]
        pointer = _pointer(context, builder, signature, values)
        return builder.extract_value(builder.cmpxchg(pointer, *pair, "acq_rel", "acquire"), 1)

    return types.boolean(numbers, k, old, new), generate


@intrinsic  # type: ignore[untyped-decorator]
def _load(typing: Any, numbers: Any, k: Any) -> Signature:
    """numbers[k], with all that was written before it was."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load_atomic(_pointer(context, builder, signature, values), "acquire", 8)

    return types.int64(numbers, k), generate


def _pointer(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, values[0])
    return builder.gep(array.data, [context.cast(builder, values[1], signature.args[1], types.intp)])
