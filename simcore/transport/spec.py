"""What to ask of the transport of photons."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from simcore.core.spec_base import Spec, quantity


class BodySpec(Spec):
    """What stands behind the chest wall, as high as the plates: without it scatter and dose at the chest wall are too
    low. TG-195 has water there."""

    material: Literal["water", "muscle"] = Field("water", description="material [1]")
    depth_mm: float = quantity(
        "how far it is followed behind the chest wall", unit="mm", default=60.0, ge=5.0, le=300.0
    )


class TransportSpec(Spec):
    """Scatter and dose by Monte Carlo in the compressed breast."""

    scatter: Literal["monte-carlo", "none"] = Field(
        "monte-carlo", description="none: no scatter reaches the detector; the dose is the same [1]"
    )
    rays_per_view: int = Field(
        75_000,
        ge=1_000,
        le=100_000_000,
        json_schema_extra={"unit": "1"},
        description="photons that are sent into each view, each scattered at eight places; the statistical errors fall "
        "with the root [1]",
    )
    equivalent_breast_rays_per_view: int = Field(
        15_000,
        ge=1_000,
        le=100_000_000,
        json_schema_extra={"unit": "1"},
        description="the same for the dose to the homogeneous equivalent breast [1]",
    )
    cell_mm: float = quantity(
        "edge of the cells that the tissues of the breast are mixed in", unit="mm", default=1.0, ge=0.2, le=5.0
    )
    grid_mm: float = quantity(
        "cells of the coarse grid on the detector that counts scatter", unit="mm", default=5.0, ge=1.0, le=20.0
    )
    body: BodySpec | None = Field(BodySpec(), description="body behind the chest wall; nothing where null")
