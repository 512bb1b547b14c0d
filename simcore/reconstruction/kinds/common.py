"""What all reconstructions share: the slices they fill, and how values are stored."""

from __future__ import annotations

import math
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import Spec, quantity


def _bound(description: str) -> float | None:
    value: float | None = Field(None, json_schema_extra={"unit": "mm"}, description=f"{description} [mm]")
    return value


class RegionSpec(Spec):
    """A box; voxels that it touches are reconstructed. A bound that is not given is that of the field."""

    x_min_mm: float | None = _bound("from the chest wall")
    x_max_mm: float | None = _bound("from the chest wall")
    y_min_mm: float | None = _bound("from the middle, along the tube travel")
    y_max_mm: float | None = _bound("from the middle, along the tube travel")
    z_min_mm: float | None = _bound("above the breast support")
    z_max_mm: float | None = _bound("above the breast support")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for axis, low, high in zip("xyz", self.lower(), self.upper(), strict=True):
            if not low < high:
                raise ValueError(f"{axis}_min_mm = {low:g} must be below {axis}_max_mm = {high:g}")
        return self

    def lower(self) -> tuple[float, ...]:
        """(x, y, z), mm; minus infinity without a bound."""
        bounds = (self.x_min_mm, self.y_min_mm, self.z_min_mm)
        return tuple(-math.inf if b is None else b for b in bounds)

    def upper(self) -> tuple[float, ...]:
        """(x, y, z), mm; infinity without a bound."""
        bounds = (self.x_max_mm, self.y_max_mm, self.z_max_mm)
        return tuple(math.inf if b is None else b for b in bounds)


class VolumeSpec(Spec):
    """Slices parallel to the detector, from the breast support upwards."""

    is_kept: ClassVar[bool] = False
    """Whether the voxels are stored beside the DICOM volume. Not where they are made about as quickly as that takes."""

    slice_mm: float = quantity("distance of the slices", unit="mm", default=1.0, ge=0.1, le=20.0)
    pixel_mm: float | None = Field(
        None,
        ge=0.02,
        le=5.0,
        json_schema_extra={"unit": "mm"},
        description="in-plane pixel edge; that of the detector where not given [mm]",
    )
    field: Literal["detector", "breast"] = Field(
        "detector",
        description="extent of the slices: the whole detector, or the bounding box of what all views see of the breast",
    )
    region: RegionSpec | None = Field(None, description="a box within the field; all of it where not given")
    value_slope: float = quantity(
        "attenuation per step of the stored 16-bit values", unit="1/mm", default=1e-5, ge=1e-8, le=1e-2
    )
    value_intercept: float = quantity("attenuation of the stored value 0", unit="1/mm", default=-0.2, ge=-100.0, le=0.0)


class IterativeSpec(VolumeSpec):
    """Volumes that are improved until their projections are those measured."""

    is_kept: ClassVar[bool] = True

    start: Literal["zero", "backprojection", "fbp"] = Field(
        "zero",
        description="what the iteration starts from: nothing, simple back-projection, or filtered back-projection "
        "(its negative values cut off)",
    )
    relaxation: float = quantity("part of the full step that is taken", unit="1", default=1.0, gt=0.0, lt=2.0)
    non_negative: bool = Field(True, description="whether negative attenuation is set to zero after every step")
    tolerance: float = quantity(
        "the iteration ends when the data misfit changes by less than this part of itself; 0: never",
        unit="1",
        default=0.0,
        ge=0.0,
        lt=1.0,
    )
    total_variation: float = quantity(
        "strength of the total variation denoising of every slice after every iteration: contrasts are lowered by up "
        "to twice this over the object's radius in pixels; 0: none",
        unit="1/mm",
        default=0.0,
        ge=0.0,
        le=1.0,
    )
    total_variation_steps: int = Field(
        15, ge=1, le=500, description="steps of the total variation denoising (Chambolle's) [1]"
    )
