"""What to ask of a reconstruction."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from simcore.reconstruction.kinds.backprojection import Backprojection
from simcore.reconstruction.kinds.common import IterativeSpec, RegionSpec, VolumeSpec
from simcore.reconstruction.kinds.fbp import FilteredBackprojection
from simcore.reconstruction.kinds.ml import MaximumLikelihood
from simcore.reconstruction.kinds.sart import Sart
from simcore.reconstruction.kinds.sirt import Sirt

__all__ = [
    "Backprojection",
    "FilteredBackprojection",
    "IterativeSpec",
    "MaximumLikelihood",
    "ReconstructionSpec",
    "RegionSpec",
    "Sart",
    "Sirt",
    "VolumeSpec",
]

ReconstructionSpec = Annotated[
    FilteredBackprojection | Backprojection | Sart | Sirt | MaximumLikelihood,
    Field(discriminator="kind", description="how the volume is reconstructed"),
]
"""Union by ``kind``: a new reconstruction is one file and one more member here."""
