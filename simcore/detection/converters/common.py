"""What all converters with a layer of matter have in common."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, field_validator

from simcore.core.spec_base import Spec, quantity
from simcore.physics.materials import standard_materials


class LayerSpec(Spec):
    """A flat layer that absorbs photons by the photo-effect, behind a cover.

    material: of simcore/physics/data/materials.csv.
    """

    material: ClassVar[str]

    cover_material: str = Field(description="material of the cover (breast support inside, housing), by its name")
    cover_mm: float = quantity("thickness of the cover", unit="mm", ge=0.0, le=20.0)
    fill_factor: float = quantity(
        "part of a pixel's area that collects; the aperture's edge is that of the pixel times its root",
        unit="1",
        default=1.0,
        gt=0.05,
        le=1.0,
    )

    @field_validator("cover_material")
    @classmethod
    def _is_a_material(cls, name: str) -> str:
        if name not in standard_materials():
            raise ValueError(f"no material {name!r}; there are {', '.join(standard_materials())}")
        return name
