"""What to ask of the warp."""

from __future__ import annotations

from simcore.core.spec_base import Spec, quantity

MOST_SKIRT_MM = 5.0


class WarpSpec(Spec):
    """Each deformed tetrahedron is rasterised; every voxel looks up its undeformed label. Lesions of few voxels that
    this would miss are carried forward as objects."""

    skirt_mm: float = quantity(
        "how far outside the polyhedral surface the map is continued, to keep the skin it cuts off",
        unit="mm",
        default=1.5,
        ge=0.0,
        le=MOST_SKIRT_MM,
    )
