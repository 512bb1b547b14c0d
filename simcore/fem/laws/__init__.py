"""Constitutive laws, one a file with its specification, energy and constants: one for the whole breast, or one a
tissue."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.laws.plain import OneLaw
from simcore.fem.laws.published import Published

MaterialSpec = Annotated[
    OneLaw | ByTissue | Published,
    Field(discriminator="kind", description="what the breast is made of: one law, or one for every tissue"),
]
