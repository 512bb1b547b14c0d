"""What to ask of a study: a base specification and the axes along which its cases differ."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, JsonValue, ValidationError, model_validator

from simcore.core.canonical import canonical
from simcore.core.errors import SpecError
from simcore.core.spec_base import Spec
from simcore.phantom.lesions import LesionSpec
from simcore.spec import spec_error
from simcore.study.distributions import Distribution

FieldPath = Annotated[
    str,
    Field(
        pattern=r"^/?[A-Za-z0-9_]+([./][A-Za-z0-9_]+)*$",
        max_length=200,
        description="a field of the specification, as a dotted path (acquisition.views) or a JSON pointer "
        "(/acquisition/views)",
    ),
]

Label = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]
"""A word for people, without control characters."""

PAIR = ("absent", "present")
"""Labels of the cases of a pair."""


def dotted(path: str) -> str:
    """The one form of a field path: acquisition.views."""
    return path.lstrip("/").replace("/", ".")


class Labelled(Spec):
    """What axes with labels share."""

    name: Label | None = Field(None, description="column of the labels in tables")
    labels: tuple[Label, ...] | None = Field(
        None, strict=False, description="one for each step of the axis; they need a name"
    )

    def _check_labels(self, steps: int) -> None:
        if (self.labels is None) != (self.name is None):
            raise ValueError("name and labels go together: the name is the column of the labels")
        if self.labels is None:
            return
        if len(self.labels) != steps:
            raise ValueError(f"{len(self.labels)} labels for {steps} steps: one for each")
        if len(set(self.labels)) < steps:
            raise ValueError("labels must differ from one another")


class GridAxis(Labelled):
    """One field takes each of some values."""

    kind: Literal["grid"] = "grid"
    field: FieldPath
    values: tuple[JsonValue, ...] = Field(min_length=1, strict=False, description="any JSON that the field takes")

    @model_validator(mode="after")
    def _labels_fit(self) -> Self:
        self._check_labels(len(self.values))
        return self

    @property
    def fields(self) -> list[str]:
        return [dotted(self.field)]


class ListAxis(Labelled):
    """Several fields change together: each point gives a value to each of them."""

    kind: Literal["list"] = "list"
    points: tuple[dict[FieldPath, JsonValue], ...] = Field(
        min_length=1, strict=False, description="{field: value}, the same fields in every point"
    )

    @model_validator(mode="after")
    def _same_fields(self) -> Self:
        self._check_labels(len(self.points))
        first = {dotted(field) for field in self.points[0]}
        if not first:
            raise ValueError("points: a point sets at least one field")
        for number, point in enumerate(self.points):
            if {dotted(field) for field in point} != first or len(point) != len(first):
                raise ValueError(f"points.{number} must set the same fields as the first point: {', '.join(first)}")
        return self

    @property
    def fields(self) -> list[str]:
        return [dotted(field) for field in self.points[0]]


class RandomAxis(Spec):
    """Each case draws a value for each of some fields; a larger count keeps the draws of a smaller one."""

    kind: Literal["random"] = "random"
    count: int = Field(ge=1, le=1_000_000, description="number of draws [1]")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="seed of the draws [1]")
    draws: dict[FieldPath, Distribution] = Field(min_length=1, description="{field: distribution}")

    @property
    def fields(self) -> list[str]:
        return [dotted(field) for field in self.draws]


class LesionPairAxis(Spec):
    """Every breast twice: without lesions and with them. All else is the same, so the pair shares its anatomy."""

    kind: Literal["lesion_pair"] = "lesion_pair"
    lesions: tuple[LesionSpec, ...] = Field(min_length=1, max_length=100, strict=False, description="known objects")
    name: Label = Field("lesions", description="column of 'absent' and 'present' in tables")

    @property
    def fields(self) -> list[str]:
        return ["phantom.lesions"]


Axis = Annotated[
    GridAxis | ListAxis | RandomAxis | LesionPairAxis,
    Field(discriminator="kind", description="a direction in which cases differ"),
]


class StudySpec(Spec):
    """A family of cases: every combination of the steps of all axes, the last axis changing fastest."""

    name: Annotated[str, Field(max_length=48, pattern=r"^[^\x00-\x1f\x7f]*$")] = Field(
        "", description="a label for people; the cases are named after it"
    )
    base: dict[str, JsonValue] = Field({}, description="what all cases share: a specification, or part of one")
    axes: tuple[Axis, ...] = Field(max_length=20, strict=False, description="at least one")

    @model_validator(mode="after")
    def _each_field_once(self) -> Self:
        if not self.axes:
            raise ValueError("axes: a study has at least one; post a single case to /v1/simulations")
        seen: dict[str, int] = {}
        for number, axis in enumerate(self.axes):
            for field in axis.fields:
                for other, where in seen.items():
                    if f"{field}.".startswith(f"{other}.") or f"{other}.".startswith(f"{field}."):
                        raise ValueError(f"axes.{number} sets {field}, and axes.{where} sets {other}: set it on one")
                seen[field] = number
        names = [column for axis in self.axes for column in label_columns(axis)]
        if len(set(names)) < len(names) or set(names) & seen.keys():
            raise ValueError(f"names of axes must differ from one another and from fields: {', '.join(names)}")
        return self

    @classmethod
    def parse(cls, text: str | bytes) -> Self:
        """From JSON.

        raises: SpecError naming every wrong field, its value and what is allowed.
        """
        try:
            study = cls.model_validate_json(text)
        except ValidationError as error:
            raise spec_error(cls, error, "study") from None
        try:
            canonical(study.model_dump(mode="json"))
        except ValueError:
            raise SpecError("NaN and Infinity are no values of a study: JSON does not know them") from None
        return study

    @property
    def steps(self) -> list[int]:
        """Steps of every axis."""
        return [_steps(axis) for axis in self.axes]

    @property
    def size(self) -> int:
        """Number of cases."""
        return math.prod(self.steps)


def _steps(axis: Axis) -> int:
    match axis:
        case GridAxis():
            return len(axis.values)
        case ListAxis():
            return len(axis.points)
        case RandomAxis():
            return axis.count
        case LesionPairAxis():
            return len(PAIR)


def label_columns(axis: Axis) -> list[str]:
    """The column of the labels of an axis; none where it has no labels."""
    if isinstance(axis, RandomAxis):
        return []
    return [] if axis.name is None else [axis.name]
