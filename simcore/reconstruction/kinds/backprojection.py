"""Back-projection without a filter."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.reconstruction.kinds.common import VolumeSpec


class Backprojection(VolumeSpec):
    """The mean over all views of what the ray through a voxel met, per length of the ray in the breast."""

    # The standard defines a term for filtered back-projection and one for iterative methods; others may be added.
    dicom_algorithm: ClassVar[str] = "BACK_PROJ"
    title: ClassVar[str] = "back-projection"

    kind: Literal["backprojection"] = "backprojection"
    method: Literal["simple", "shift-and-add"] = Field(
        "simple",
        description="simple: along the rays of every view; shift-and-add: the projections are shifted alone, by the "
        "parallax of the slice, and enlarged all alike (Niklason 1997): exact for a tube that moves parallel to the "
        "detector",
    )

    @classmethod
    def example(cls) -> Backprojection:
        return cls(method="shift-and-add")
