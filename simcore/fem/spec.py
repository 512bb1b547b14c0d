"""What to ask of the compression."""

from __future__ import annotations

from pydantic import Field

from simcore.core.spec_base import Spec, quantity
from simcore.fem.materials import MaterialSpec
from simcore.fem.materials.neo_hookean import NeoHookean


class CompressionSpec(Spec):
    """Two rigid, frictionless, parallel plates move towards the middle of the breast by the same distance. The chest
    wall is held along x and free in its plane."""

    percent: float = quantity("reduction of the uncompressed thickness", unit="%", default=50.0, gt=0.0, le=75.0)
    material: MaterialSpec = NeoHookean()
    load_steps: int = Field(
        1, ge=1, le=100, description="load steps to begin with; halved by itself where one fails [1]"
    )
    tolerance: float = quantity(
        "residual force relative to the plate force at which a load step has converged",
        unit="1",
        default=1e-5,
        ge=1e-10,
        le=1e-2,
    )
