"""A solid in the breast, and what the specifications of lesions share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import Field

from simcore.core.spec_base import Spec
from simcore.core.tissues import Tissue

if TYPE_CHECKING:  # specifications are read where nothing may load numerics
    import numpy as np
    from numpy.typing import NDArray

    from simcore.core.grid import Point

    Offsets = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """A solid of one tissue.

    offset: (x, y, z) of its centre from that of the lesion, mm.
    size:   edges of its bounding box along (x, y, z), mm; it is symmetric about the centre.
    inside: whether points lie in it: (dx, dy, dz) from its centre, mm, broadcast against one another, to bool.
    """

    tissue: Tissue
    offset: Point
    size: Point
    inside: Callable[[Offsets, Offsets, Offsets], NDArray[np.bool_]]


class Placed(Spec):
    """Where a lesion lies."""

    centre_mm: tuple[float, float, float] | None = Field(
        None,
        strict=False,
        json_schema_extra={"unit": "mm"},
        description="centre (x, y, z) in the breast frame: x from the chest wall, y along the tube travel, z towards "
        "the source; a random place in the gland where not given [mm]",
    )
