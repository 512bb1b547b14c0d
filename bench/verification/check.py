"""One line of the verification: what was expected, what came out, and whether that is near enough."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """error: difference of ``got`` from ``expected`` in the sense that ``kind`` names; tolerance: its bound."""

    group: str
    what: str
    expected: str
    got: str
    error: float
    tolerance: float
    kind: str = "relative"

    @property
    def passed(self) -> bool:
        return abs(self.error) <= self.tolerance


def relative(group: str, what: str, expected: float, got: float, tolerance: float, unit: str = "") -> Check:
    """got / expected - 1"""
    return Check(group, what, _number(expected, unit), _number(got, unit), got / expected - 1, tolerance)


def absolute(group: str, what: str, got: float, tolerance: float, unit: str = "", *, expected: float = 0.0) -> Check:
    """got - expected, in its unit"""
    return Check(group, what, _number(expected, unit), _number(got, unit), got - expected, tolerance, "absolute")


def at_least(group: str, what: str, least: float, got: float, unit: str = "") -> Check:
    """What is missing to ``least``."""
    return Check(
        group, what, f"at least {_number(least, unit)}", _number(got, unit), max(least - got, 0.0), 0.0, "missing"
    )


def _number(value: float, unit: str) -> str:
    return f"{value:.7g} {unit}".strip()
