"""Waiting for what another thread or process does."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
PATIENCE_SECONDS = 90.0


def wait_for(
    condition: Callable[[], T], what: str = "it", seconds: float = PATIENCE_SECONDS, pause_seconds: float = 0.02
) -> T:
    """The first true value of a condition.

    raises: AssertionError naming ``what`` after ``seconds``, and whatever the condition raises
    """
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what} did not happen within {seconds:g} s"
        time.sleep(pause_seconds)
    return value
