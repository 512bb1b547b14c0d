"""A mass: an ellipsoid with rounded lobes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from simcore.core.spec_base import quantity
from simcore.core.tissues import Tissue
from simcore.phantom.lesions.body import Body, Placed

if TYPE_CHECKING:  # a specification is read where nothing may load numerics
    import numpy as np
    from numpy.typing import NDArray

    from simcore.phantom.lesions.body import Offsets

_DIRECTIONS = 4000
"""Directions over which the volume of a lobed mass is set."""

Edge = Annotated[float, Field(ge=0.1, le=150.0)]


class Mass(Placed):
    """An ellipsoid along the axes; with ``lobulation``, rounded lobes stand out of it and its volume stays."""

    kind: Literal["mass"] = "mass"
    size_mm: tuple[Edge, Edge, Edge] = Field(
        (10.0, 10.0, 10.0),
        strict=False,
        json_schema_extra={"unit": "mm"},
        description="diameters of the ellipsoid along (x, y, z) [mm]",
    )
    lobulation: float = quantity(
        "height of the lobes, relative to the radius of the ellipsoid", unit="1", default=0.0, ge=0.0, le=1.0
    )
    lobes: int = Field(8, ge=1, le=60, description="number of lobes [1]")

    @classmethod
    def example(cls) -> Mass:
        return cls(centre_mm=(40.0, 0.0, 0.0), lobulation=0.3)

    def bodies(self, random: np.random.Generator) -> list[Body]:
        """One solid."""
        import numpy as np

        half = np.array(self.size_mm) / 2
        if self.lobulation == 0:
            return [Body(Tissue.MASS, (0.0, 0.0, 0.0), self.size_mm, lambda x, y, z: _relative(x, y, z, half)[0] <= 1)]
        peaks = random.normal(size=(self.lobes, 3))
        peaks /= np.linalg.norm(peaks, axis=1)[:, None]

        def lobed(directions: NDArray[np.float64]) -> NDArray[np.float64]:
            # Bumps whose width shrinks as their number grows, so that they stay apart.
            bumps = np.zeros(directions.shape[:-1])
            for peak in peaks:
                bumps = np.maximum(bumps, np.exp((4.0 + self.lobes / 2) * (directions @ peak - 1.0)))
            return 1.0 + self.lobulation * bumps

        around = lobed(_even_directions(_DIRECTIONS))
        same_volume = float(np.cbrt(np.mean(around**3)))
        reach = (1.0 + self.lobulation) / same_volume

        def inside(x: Offsets, y: Offsets, z: Offsets) -> NDArray[np.bool_]:
            radius, directions = _relative(x, y, z, half)
            result: NDArray[np.bool_] = radius * same_volume <= lobed(directions)
            return result

        a, b, c = (reach * size for size in self.size_mm)
        return [Body(Tissue.MASS, (0.0, 0.0, 0.0), (a, b, c), inside)]


def _relative(
    x: Offsets, y: Offsets, z: Offsets, half: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radius in units of the ellipsoid, and direction (..., 3) in the frame in which it is a sphere."""
    import numpy as np

    points = np.stack(np.broadcast_arrays(x / half[0], y / half[1], z / half[2]), axis=-1)
    radius = np.linalg.norm(points, axis=-1)
    return radius, points / np.maximum(radius, 1e-12)[..., None]


def _even_directions(number: int) -> NDArray[np.float64]:
    """Points of a Fibonacci spiral on the unit sphere, (number, 3)."""
    import numpy as np

    k = np.arange(number) + 0.5
    z, turn = 1.0 - 2.0 * k / number, math.pi * (1.0 + math.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
