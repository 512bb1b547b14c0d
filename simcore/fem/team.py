"""Threads that share a computation of many short rounds without waking and sleeping.

A round is a fixed number of parts that may be computed at the same time; its parts begin when those of the round before
are finished. Whoever is free takes the next ticket, one number for round and part; what a part computes does not depend
on who computes it, so one thread or many, the result is the same. Waiting is spinning. Where a wait is long the machine
has given a processor to somebody else: then the team breaks up, and the caller goes on alone.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit
from simcore.simd.atomics import add, load, replace

Result = TypeVar("Result")

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
        if not callers and load(numbers, _ALONE) > 0:
            return LEAVE, 0
        ticket = load(numbers, _TAKEN)
        if load(numbers, _FINISHED) >= ticket - ticket % parts and replace(numbers, _TAKEN, ticket, ticket + 1):
            return ticket // parts, ticket % parts
        looks += 1
        if looks == patience:
            add(numbers, _ALONE, 1)


@njit(cache=True, nogil=True)
def finish(numbers: NDArray[np.int64]) -> None:
    """The part is computed."""
    add(numbers, _FINISHED, 1)
