"""What all converters with a layer of matter have in common."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from simcore.core.spec_base import Spec, quantity
from simcore.physics.spec import FilterMaterial


class LayerSpec(Spec):
    """A flat layer that absorbs photons by the photo-effect, behind a cover.

    material: of simcore/physics/data/materials.csv.
    """

    material: ClassVar[str]

    cover_material: FilterMaterial = Field(description="material of the cover (breast support inside, housing)")
    cover_mm: float = quantity("thickness of the cover", unit="mm", ge=0.0, le=20.0)
    fill_factor: float = quantity(
        "part of a pixel's area that collects; the aperture's edge is that of the pixel times its root",
        unit="1",
        default=1.0,
        gt=0.05,
        le=1.0,
    )
