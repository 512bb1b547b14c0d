"""Pieces beside the breast: small ones are dropped and told, large ones refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.components import Components, Extents, slabs
from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue

Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
"""(first, behind the last) voxel along the axes of an array."""
WHOLE = 0.99
"""Least part of the tissue that must hang together: only one body can be compressed."""


def check(extents: Extents, voxel_mm3: float) -> None:
    """raises: SpecError where the largest piece is less than WHOLE of all"""
    voxels = np.sort(extents.voxels)[::-1]
    if voxels[0] >= WHOLE * voxels.sum():
        return
    ml = ", ".join(f"{v * voxel_mm3 * 1e-3:.3g}" for v in voxels[:5]) + (", ..." if len(voxels) > 5 else "")
    message = (
        f"the tissue falls into {len(voxels)} pieces of {ml} ml; only one connected body can be compressed, and what "
        f"lies beside it may be {1 - WHOLE:.0%} of all: clear the other labels, or map them to 'air'"
    )
    raise SpecError(
        f"phantom.tissues: {message}",
        code="upload-in-pieces",
        problems=[{"field": "phantom.tissues", "value": None, "message": message}],
    )


def body_box(extents: Extents, voxel_mm3: float) -> Box | None:
    """Box of the largest piece of several, along the axes of the array; None where there is but one.

    raises: SpecError as ``check``
    """
    if len(extents) < 2:
        return None
    check(extents, voxel_mm3)
    first, behind = extents.first[extents.largest], extents.behind[extents.largest]
    a, b, c = ((int(low), int(high)) for low, high in zip(first, behind, strict=True))
    return a, b, c


def drop(labels: NDArray[np.uint8]) -> None:
    """Makes all tissue (z, y, x) but the largest piece air, in place."""
    components = Components(corners=True, centres=False)
    for _, slab in slabs(labels):
        components.add(slab != Tissue.AIR)
    extents = components.extents()
    if len(extents) > 1:
        again = Components(corners=True, centres=False)
        for _, slab in slabs(labels):
            numbers = again.add(slab != Tissue.AIR)
            slab[extents.of[numbers] != extents.largest] = Tissue.AIR
