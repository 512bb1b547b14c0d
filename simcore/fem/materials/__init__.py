"""Constitutive laws, one a file: one for the whole breast, or one a tissue."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from simcore.fem.materials.by_tissue import ByTissue
from simcore.fem.materials.linear_elastic import LinearElastic
from simcore.fem.materials.mooney_rivlin import MooneyRivlin
from simcore.fem.materials.neo_hookean import NeoHookean
from simcore.fem.materials.polynomial import Polynomial
from simcore.fem.materials.published import Published
from simcore.fem.materials.veronda_westmann import VerondaWestmann
from simcore.fem.materials.wellman import Wellman

MaterialSpec = Annotated[
    NeoHookean | MooneyRivlin | Polynomial | VerondaWestmann | Wellman | LinearElastic | ByTissue | Published,
    Field(discriminator="kind", description="what the breast is made of: one law, or one for every tissue"),
]
