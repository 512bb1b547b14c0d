"""Answers about label volumes."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field


class Content(BaseModel):
    """What voxels of one value are taken for."""

    value: int
    tissue: str = Field(description="or 'air' or 'paddle', which are none")
    voxels: int
    ml: float = Field(description="volume [ml]")
    share: float | None = Field(description="of the volume of all tissue; null for what is none [1]")


class PhantomResource(BaseModel):
    """A label volume in the store."""

    sha256: str = Field(
        description="digest of the stored file: that of the body, or where raw voxels got a header, of both"
    )
    name: str
    size: int = Field(description="[byte]")
    format: str
    values: dict[str, int] = Field(description="voxels of every value")
    contents: list[Content] = Field(description="tissue and volume of every value")
    remarks: list[str] = Field(description="what is odd, read otherwise than it stands in the file, cut or left out")
    specification: dict[str, Any] = Field(description="to be posted to /v1/simulations, with whatever else is wanted")
    links: dict[str, str]


class PhantomList(BaseModel):
    """All label volumes in the store."""

    items: list[PhantomResource]
