"""Simultaneous iterative reconstruction: all views at once."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.reconstruction.kinds.common import IterativeSpec


class Sirt(IterativeSpec):
    """SIRT (P. Gilbert, J. Theor. Biol. 36 (1972) 105; J. Gregor, T. Benson, IEEE Trans. Med. Imaging 27 (2008) 918):
    the weighted misfit falls with every iteration."""

    dicom_algorithm: ClassVar[str] = "ITERATIVE"
    title: ClassVar[str] = "simultaneous iterative reconstruction"

    kind: Literal["sirt"] = "sirt"
    iterations: int = Field(20, ge=1, le=2000, description="corrections of the volume, at most [1]")

    @classmethod
    def example(cls) -> Sirt:
        return cls(iterations=10, start="backprojection", tolerance=0.01)
