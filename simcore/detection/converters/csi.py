"""Columnar caesium iodide on photodiodes: light spreads before it is read."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import quantity
from simcore.detection.converters.common import LayerSpec
from simcore.physics.spec import FilterMaterial


class CaesiumIodide(LayerSpec):
    """CsI(Tl)."""

    material: ClassVar[str] = "caesium-iodide"

    kind: Literal["csi"] = "csi"
    thickness_mm: float = quantity(
        "thickness of solid CsI of the same mass; columns with gaps are thicker",
        unit="mm",
        default=0.1,
        gt=0.0,
        le=2.0,
    )
    cover_material: FilterMaterial = Field(
        "carbon-fibre", description="material of the cover (breast support inside, housing)"
    )
    cover_mm: float = quantity("thickness of the cover", unit="mm", default=0.5, ge=0.0, le=20.0)
    swank: float = quantity(
        "Swank factor of the light of one absorbed energy, without K fluorescence",
        unit="1",
        default=0.85,
        gt=0.1,
        le=1.0,
    )
    electrons_per_keV: float = quantity(
        "electrons read per absorbed energy", unit="1/keV", default=25.0, gt=0.0, le=1000.0
    )
    uncorrelated: float = quantity(
        "part of the quantum noise power that light does not correlate: |k|^2 = e + (1 - e) MTF^2",
        unit="1",
        default=0.1,
        ge=0.0,
        le=1.0,
    )
