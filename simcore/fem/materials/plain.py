"""The union of the laws of one material; a new law is one file and one line here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from simcore.fem.materials.linear_elastic import LinearElastic
from simcore.fem.materials.mooney_rivlin import MooneyRivlin
from simcore.fem.materials.neo_hookean import NeoHookean
from simcore.fem.materials.polynomial import Polynomial
from simcore.fem.materials.veronda_westmann import VerondaWestmann
from simcore.fem.materials.wellman import Wellman

PlainLaw = Annotated[
    NeoHookean | MooneyRivlin | Polynomial | VerondaWestmann | Wellman | LinearElastic,
    Field(discriminator="kind", description="constitutive law"),
]
