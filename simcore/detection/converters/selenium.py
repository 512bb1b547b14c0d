"""Amorphous selenium: charge is drawn straight to the pixel; only K fluorescence spreads it."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import quantity
from simcore.detection.converters.common import LayerSpec
from simcore.physics.spec import FilterMaterial


class Selenium(LayerSpec):
    """a-Se."""

    material: ClassVar[str] = "selenium"

    kind: Literal["a-se"] = "a-se"
    thickness_mm: float = quantity("thickness of the layer", unit="mm", default=0.2, gt=0.0, le=2.0)
    cover_material: FilterMaterial = Field(
        "carbon-fibre", description="material of the cover (breast support inside, housing)"
    )
    cover_mm: float = quantity("thickness of the cover", unit="mm", default=0.5, ge=0.0, le=20.0)
    swank: float = quantity(
        "Swank factor of the charge of one absorbed energy, without K fluorescence",
        unit="1",
        default=0.99,
        gt=0.1,
        le=1.0,
    )
    electrons_per_keV: float = quantity(
        "electrons read per absorbed energy: 1000 over the energy of a pair in eV",
        unit="1/keV",
        default=20.0,
        gt=0.0,
        le=1000.0,
    )
    fluorescence_blur: bool = Field(
        True, description="whether K photons that are absorbed elsewhere blur the signal and correlate the noise"
    )
