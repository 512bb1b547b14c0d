"""Published ranges that a simulated case is held against, and how it stands.

Outside a range is a fact about the case, not an error: a breast of 96 mm or a reconstruction without low frequencies
may be what was asked for.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from simcore.core.artifacts import Report


@dataclass(frozen=True)
class Range:
    """low..high of a quantity, inclusive, and whose values they are."""

    quantity: str
    low: float
    high: float
    unit: str
    source: str

    def check(self, value: float | None) -> Report:
        """The range with the value and whether it lies inside (None where it was not measured)."""
        inside = None if value is None else self.low <= value <= self.high
        return {**asdict(self), "value": value, "in_range": inside}


def two_sigma(quantity: str, mean: float, std: float, unit: str, source: str) -> Range:
    """The middle 95 % of a normal distribution."""
    return Range(quantity, round(mean - 2 * std, 6), round(mean + 2 * std, 6), unit, source)


RANGES = {
    r.quantity: r
    for r in (
        two_sigma("projection beta", 3.17, 0.23, "1", "cranio-caudal mammograms, 3.17 +- 0.23"),
        two_sigma("slice beta", 3.06, 0.36, "1", "cranio-caudal tomosynthesis slices, 3.06 +- 0.36"),
        Range("skin thickness", 0.87, 2.34, "mm", "137 breast CTs, 1.44 +- 0.25, extremes"),
        Range("glandularity", 0.0, 0.45, "1", "volume of gland over volume with skin; 95 % of women"),
        two_sigma("compressed thickness", 59.0, 16.0, "mm", "compressed breasts, 59 +- 16"),
        Range("force", 49.0, 186.0, "N", "clinical mammography, Sullivan et al. 1991"),
    )
}


def checks(values: dict[str, float | None]) -> list[Report]:
    """All ranges in their order with the values of a case; a quantity that is missing counts as not measured."""
    return [r.check(values.get(name)) for name, r in RANGES.items()]
