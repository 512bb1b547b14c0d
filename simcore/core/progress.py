"""Progress of a stage: one callback, called with a fraction in [0, 1] and a short message."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]


def silent(fraction: float, message: str) -> None:
    """The callback that does nothing."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """The callback for a sub-task that covers [start, stop] of ``progress``."""

    def report(fraction: float, message: str) -> None:
        progress(start + (stop - start) * fraction, message)

    return report
