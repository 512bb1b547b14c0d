"""Specifications of what blurs: presampled transfer, and the power spectrum of the quantum noise. Data alone."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import Spec, quantity

Frequencies = Annotated[
    list[float],
    Field(min_length=2, max_length=1000, description="frequencies, increasing from 0 [1/mm]"),
]
ABOVE_ONE = 0.02
"""A measured transfer may exceed 1, or that of the aperture, by so much."""


class ApertureTransfer(Spec):
    """The pixel's aperture alone, and K fluorescence where the converter has it."""

    kind: Literal["aperture"] = "aperture"


class RationalTransfer(Spec):
    """Aperture times 1 / (1 + (f / half)^power): light or charge that spreads."""

    kind: Literal["rational"] = "rational"
    half_per_mm: float = quantity(
        "frequency at which the converter, without aperture, transfers a half", unit="1/mm", gt=0.05, le=100.0
    )
    power: float = quantity("exponent of the frequency", unit="1", default=1.5, ge=1.0, le=4.0)


class TableTransfer(Spec):
    """A measured presampled MTF along a row, aperture and K fluorescence included. What is not the aperture's is the
    same in all directions; along the diagonals it goes on beyond the table with its last value."""

    kind: Literal["table"] = "table"
    frequencies_per_mm: Frequencies
    values: list[float] = Field(description="presampled MTF there, 1 at frequency 0 [1]")

    @model_validator(mode="after")
    def _is_a_transfer(self) -> Self:
        check_table(self.frequencies_per_mm, self.values, "values")
        if abs(self.values[0] - 1) > 1e-6:
            raise ValueError(f"values[0] = {self.values[0]:g}: the MTF at frequency 0 is 1; divide all by it")
        highest = max(self.values)
        if highest > 1 + ABOVE_ONE:
            raise ValueError(f"values reach {highest:g}: an MTF does not exceed 1 (by more than {ABOVE_ONE:g})")
        return self


class ConverterPower(Spec):
    """What the converter does: light of CsI correlates the noise, K photons of a-Se a little, nothing else does."""

    kind: Literal["converter"] = "converter"


class WhitePower(Spec):
    """No correlation between pixels."""

    kind: Literal["white"] = "white"


class TablePower(Spec):
    """A measured noise power spectrum along a row, of quantum noise; its scale does not matter. The same in all
    directions; along the diagonals it goes on beyond the table with its last value."""

    kind: Literal["table"] = "table"
    frequencies_per_mm: Frequencies
    values: list[float] = Field(description="power there, any unit; that at frequency 0 is the variance of large areas")

    @model_validator(mode="after")
    def _is_a_spectrum(self) -> Self:
        check_table(self.frequencies_per_mm, self.values, "values")
        if not self.values[0] > 0:
            raise ValueError(f"values[0] = {self.values[0]:g}: the power at frequency 0 must be above 0")
        return self


TransferSpec = Annotated[
    ApertureTransfer | RationalTransfer | TableTransfer,
    Field(discriminator="kind", description="presampled modulation transfer at perpendicular incidence"),
]
PowerSpec = Annotated[
    ConverterPower | WhitePower | TablePower,
    Field(discriminator="kind", description="how the quantum noise of pixels is correlated"),
]


def check_table(frequencies: list[float], values: list[float], name: str) -> None:
    """raises: ValueError naming what is wrong with a table over frequencies"""
    if len(frequencies) != len(values):
        raise ValueError(f"{len(frequencies)} frequencies_per_mm but {len(values)} {name}: give one for each")
    if frequencies[0] != 0:
        raise ValueError(f"frequencies_per_mm begin at {frequencies[0]:g}; they must begin at 0")
    for place, (low, high) in enumerate(pairwise(frequencies)):
        if not low < high:
            raise ValueError(f"frequencies_per_mm[{place + 1}] = {high:g} does not exceed the one before, {low:g}")
    for place, value in enumerate(values):
        if value < 0:
            raise ValueError(f"{name}[{place}] = {value:g} must not be below 0")
