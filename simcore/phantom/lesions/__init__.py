"""Lesions: objects of known place, size and tissue. One file each: its specification and the bodies it consists of."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from simcore.phantom.lesions.body import Body
from simcore.phantom.lesions.calcifications import CalcificationCluster
from simcore.phantom.lesions.mass import Mass

__all__ = ["Body", "CalcificationCluster", "LesionSpec", "Mass"]

LesionSpec = Annotated[Mass | CalcificationCluster, Field(discriminator="kind", description="a known object")]
"""Union by ``kind``: a new lesion is one file and one more member here."""
