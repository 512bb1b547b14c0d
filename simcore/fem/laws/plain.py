"""The union of the laws of one material; a new law is one file and its name here."""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import Field

from simcore.fem.laws.law import Energy
from simcore.fem.laws.linear_elastic import LinearElastic
from simcore.fem.laws.mooney_rivlin import MooneyRivlin
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.polynomial import Polynomial
from simcore.fem.laws.veronda_westmann import VerondaWestmann
from simcore.fem.laws.wellman import Wellman

OneLaw = NeoHookean | MooneyRivlin | Polynomial | VerondaWestmann | Wellman | LinearElastic
PlainLaw = Annotated[OneLaw, Field(discriminator="kind", description="constitutive law")]

ENERGIES: tuple[Energy, ...] = tuple(energy for law in get_args(OneLaw) for energy in law.energies)
"""Of all laws."""
