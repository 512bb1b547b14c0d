"""Base of all specifications: frozen pydantic models, unknown keys refused, types never coerced."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field


class Spec(BaseModel):
    """Frozen data. A change is a revalidated copy: ``spec.with_(voxel_mm=0.1)``.

    Strict: "20" is not a number and 1.5 is not an integer (an integer is accepted where a float is wanted).
    Use only types that JSON has (numbers, strings, booleans, lists, objects), so that Python and JSON agree.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
        use_attribute_docstrings=False,
    )

    def with_(self, **changes: Any) -> Self:
        """A copy with some fields changed, validated again.

        raises: pydantic.ValidationError
        """
        return type(self).model_validate({**{k: getattr(self, k) for k in type(self).model_fields}, **changes})


def quantity(description: str, *, unit: str, default: Any = ..., **bounds: Any) -> Any:
    """A number with a unit and bounds: the unit stands in the description and as ``unit`` in the JSON Schema."""
    text = f"{description} [{unit}]"
    return Field(default, description=text, json_schema_extra={"unit": unit}, **bounds)


PositiveMm = Annotated[float, Field(gt=0)]
