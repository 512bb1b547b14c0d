"""A cluster of calcifications: spheres strewn over a sphere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import quantity
from simcore.core.tissues import Tissue
from simcore.phantom.lesions.body import Body, Placed

if TYPE_CHECKING:  # a specification is read where nothing may load numerics
    import numpy as np
    from numpy.typing import NDArray

    from simcore.phantom.lesions.body import Offsets


class CalcificationCluster(Placed):
    """``count`` spheres with centres evenly at random in a sphere of diameter ``cluster_mm`` and diameters evenly at
    random between the two limits. One that is smaller than a voxel fills the voxel its centre lies in."""

    kind: Literal["calcifications"] = "calcifications"
    count: int = Field(10, ge=1, le=200, description="number of calcifications [1]")
    cluster_mm: float = quantity("diameter of the cluster", unit="mm", default=10.0, ge=0.0, le=100.0)
    smallest_mm: float = quantity("diameter of the smallest calcification", unit="mm", default=0.2, ge=0.05, le=5.0)
    largest_mm: float = quantity("diameter of the largest calcification", unit="mm", default=0.5, ge=0.05, le=5.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.largest_mm < self.smallest_mm:
            raise ValueError(f"largest_mm = {self.largest_mm:g} is below smallest_mm = {self.smallest_mm:g}")
        return self

    @classmethod
    def example(cls) -> CalcificationCluster:
        return cls(centre_mm=(40.0, 0.0, 0.0))

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Edges of the bounding box, mm."""
        return (self.cluster_mm + self.largest_mm,) * 3

    def bodies(self, random: np.random.Generator) -> list[Body]:
        """One sphere a calcification."""
        import numpy as np

        directions = random.normal(size=(self.count, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        centres = directions * (self.cluster_mm / 2 * np.cbrt(random.random((self.count, 1))))
        diameters = random.uniform(self.smallest_mm, self.largest_mm, self.count)
        return [_sphere(centre, float(diameter)) for centre, diameter in zip(centres, diameters, strict=True)]


def _sphere(centre: NDArray[np.float64], diameter: float) -> Body:
    def inside(x: Offsets, y: Offsets, z: Offsets) -> NDArray[np.bool_]:
        result: NDArray[np.bool_] = x**2 + y**2 + z**2 <= (diameter / 2) ** 2
        return result

    x, y, z = (float(c) for c in centre)
    return Body(Tissue.CALCIFICATION, (x, y, z), (diameter, diameter, diameter), inside)
