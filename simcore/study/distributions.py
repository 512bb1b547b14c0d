"""Distributions of random axes. Each value of a case is drawn by itself, in the order of the cases."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, JsonValue, model_validator

from simcore.core.spec_base import Spec

if TYPE_CHECKING:
    import numpy as np

_TRIES = 1000
"""Draws of a normal distribution after which one of the cut distribution is made from its distribution function."""


class Interval(Spec):
    """Two bounds."""

    low: float
    high: float

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low = {self.low:g} must lie below high = {self.high:g}")
        return self


class Uniform(Interval):
    """Evenly between low and high."""

    kind: Literal["uniform"] = "uniform"

    def draw(self, random: np.random.Generator) -> float:
        return float(random.uniform(self.low, self.high))


class LogUniform(Interval):
    """Evenly between low and high on a logarithmic scale."""

    kind: Literal["log_uniform"] = "log_uniform"

    @model_validator(mode="after")
    def _positive(self) -> Self:
        if self.low <= 0:
            raise ValueError(f"low = {self.low:g} must be above 0")
        return self

    def draw(self, random: np.random.Generator) -> float:
        value = math.exp(random.uniform(math.log(self.low), math.log(self.high)))
        return min(max(value, self.low), self.high)


class Normal(Interval):
    """A normal distribution, cut at low and high."""

    kind: Literal["normal"] = "normal"
    mean: float
    standard_deviation: float = Field(gt=0)

    @model_validator(mode="after")
    def _mean_inside(self) -> Self:
        if not self.low <= self.mean <= self.high:
            raise ValueError(f"mean = {self.mean:g} must lie between low = {self.low:g} and high = {self.high:g}")
        return self

    def draw(self, random: np.random.Generator) -> float:
        for _ in range(_TRIES):
            value = float(random.normal(self.mean, self.standard_deviation))
            if self.low <= value <= self.high:
                return value
        from scipy.special import ndtr, ndtri  # seldom needed, and the service that reads studies stays light

        low, high = (float(ndtr((bound - self.mean) / self.standard_deviation)) for bound in (self.low, self.high))
        value = self.mean + self.standard_deviation * float(ndtri(random.uniform(low, high)))
        return min(max(value, self.low), self.high)


class Integer(Spec):
    """A whole number from low to high, both included: seeds, for instance."""

    kind: Literal["integer"] = "integer"
    low: int = Field(0, ge=-(2**53), le=2**53)
    high: int = Field(2**31 - 1, ge=-(2**53), le=2**53)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low = {self.low} must not lie above high = {self.high}")
        return self

    def draw(self, random: np.random.Generator) -> int:
        return int(random.integers(self.low, self.high, endpoint=True))


class Choice(Spec):
    """One of some values, each as likely."""

    kind: Literal["choice"] = "choice"
    values: tuple[JsonValue, ...] = Field(min_length=1, strict=False)

    def draw(self, random: np.random.Generator) -> JsonValue:
        return self.values[int(random.integers(len(self.values)))]


Distribution = Annotated[
    Uniform | LogUniform | Normal | Integer | Choice,
    Field(discriminator="kind", description="from what the value of a case is drawn"),
]
