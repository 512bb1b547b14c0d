import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

from simcore.fem import team
from simcore.fem.team import LEAVE, begin, finish, tickets, together

PARTS, ROUNDS = 4, 500
PATIENT = 10**9


@njit(nogil=True)
def smooth(numbers, patience, callers, values):  # type: ignore[no-untyped-def]
    """Every round takes the mean of each value and its left neighbour, a part at a time; (rounds, parts done here)."""
    width, done = values.shape[1] // PARTS, 0
    while True:
        turn, part = begin(numbers, PARTS, patience, callers)
        if turn in (LEAVE, ROUNDS):
            return turn, done
        now, then = values[turn % 2], values[(turn + 1) % 2]
        for k in range(part * width, (part + 1) * width):
            then[k] = 0.5 * (now[k] + now[k - 1])
        done += 1
        finish(numbers)


def smoothed_alone(values: np.ndarray) -> np.ndarray:
    for _ in range(ROUNDS):
        values = 0.5 * (values + np.roll(values, 1))
    return values


def test_no_round_begins_before_the_last_is_finished(threads: Callable[[int], None]) -> None:
    values = np.stack([np.random.default_rng(1).normal(size=4000)] * 2)
    expected, numbers, shares = smoothed_alone(values[0]), tickets(), []

    def work(callers: bool) -> int:
        turn, done = smooth(numbers, PATIENT, callers, values)
        shares.append(done)
        return int(turn)

    smooth(tickets(), PATIENT, True, values.copy())
    threads(2)
    assert together(work, PARTS) == ROUNDS
    assert len(shares) == 2
    assert sum(shares) == PARTS * ROUNDS
    assert (values[ROUNDS % 2] == expected).all()


def test_one_thread_does_all() -> None:
    values = np.stack([np.random.default_rng(1).normal(size=4000)] * 2)
    expected = smoothed_alone(values[0])
    assert tuple(smooth(tickets(), PATIENT, True, values)) == (ROUNDS, PARTS * ROUNDS)
    assert (values[ROUNDS % 2] == expected).all()


def test_a_long_wait_breaks_the_team_up_and_the_caller_goes_on() -> None:
    values = np.stack([np.random.default_rng(1).normal(size=4000)] * 2)
    expected, numbers = smoothed_alone(values[0]), tickets()
    counts = begin(numbers, PARTS, PATIENT, False)
    assert tuple(counts) == (0, 0)
    left: list[tuple[int, int]] = []
    caller = threading.Thread(target=lambda: left.append(tuple(smooth(numbers, 1000, True, values))))
    caller.start()
    while numbers[team._ALONE] == 0:
        time.sleep(0.001)
    # The member that the machine had held up finishes its part and learns that nobody counts on it.
    width = values.shape[1] // PARTS
    values[1, :width] = 0.5 * (values[0, :width] + np.roll(values[0], 1)[:width])
    finish(numbers)
    assert tuple(begin(numbers, PARTS, 1000, False)) == (LEAVE, 0)
    caller.join()
    assert left == [(ROUNDS, PARTS * ROUNDS - 1)]
    assert (values[ROUNDS % 2] == expected).all()


def test_what_a_member_raises_is_not_lost(threads: Callable[[int], None]) -> None:
    def work(callers: bool) -> int:
        if not callers:
            raise ZeroDivisionError
        return 1

    threads(2)
    with pytest.raises(ZeroDivisionError):
        together(work, 2)
    threads(1)
    assert together(work, 2) == 1
