"""Maximum likelihood for transmission."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import quantity
from simcore.reconstruction.kinds.common import IterativeSpec


class MaximumLikelihood(IterativeSpec):
    """Maximum likelihood of Poisson counts by separable paraboloidal surrogates (H. Erdogan, J. A. Fessler, Phys. Med.
    Biol. 44 (1999) 2835): with all views in one subset the likelihood rises with every iteration."""

    dicom_algorithm: ClassVar[str] = "ITERATIVE"
    title: ClassVar[str] = "maximum-likelihood reconstruction"

    kind: Literal["ml"] = "ml"
    iterations: int = Field(10, ge=1, le=2000, description="passes over all views, at most [1]")
    relaxation: float = quantity("part of the full step that is taken", unit="1", default=1.0, gt=0.0, lt=2.0)
    views_per_subset: int | None = Field(
        None, ge=1, le=101, description="views that correct the volume together; all of them where not given [1]"
    )

    @classmethod
    def example(cls) -> MaximumLikelihood:
        return cls(iterations=5, views_per_subset=3, start="backprojection")
