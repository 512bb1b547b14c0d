"""Constitutive laws, one a file. ``MaterialSpec`` is their union: a new law is one file and one line here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from simcore.fem.materials.neo_hookean import NeoHookean

MaterialSpec = Annotated[NeoHookean, Field(description="constitutive law of the breast")]
