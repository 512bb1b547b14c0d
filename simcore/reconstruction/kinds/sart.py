"""Simultaneous algebraic reconstruction, view by view or subset by subset."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import quantity
from simcore.reconstruction.kinds.common import IterativeSpec


class Sart(IterativeSpec):
    """SART (A. H. Andersen, A. C. Kak, Ultrason. Imaging 6 (1984) 81); more than one view a subset: OS-SART (G. Wang,
    M. Jiang, J. X-Ray Sci. Technol. 12 (2004) 169)."""

    dicom_algorithm: ClassVar[str] = "ITERATIVE"
    title: ClassVar[str] = "simultaneous algebraic reconstruction"

    kind: Literal["sart"] = "sart"
    iterations: int = Field(3, ge=1, le=500, description="passes over all views, at most [1]")
    relaxation: float = quantity("part of the full step that is taken", unit="1", default=0.5, gt=0.0, lt=2.0)
    views_per_subset: int = Field(1, ge=1, le=101, description="views that correct the volume together [1]")

    @classmethod
    def example(cls) -> Sart:
        return cls(iterations=2, pixel_mm=0.2, total_variation=1e-4)
