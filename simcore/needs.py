"""Needs of a case, as they are estimated before it runs."""

from __future__ import annotations

from pydantic import BaseModel, Field


class Estimate(BaseModel):
    """Needs of one case whose breast is not in the store yet."""

    voxels: int = Field(description="voxels of the uncompressed phantom [1]")
    memory_bytes: int = Field(description="largest resident memory of the compute process [byte]")
    storage_bytes: int = Field(description="room in the store, intermediate results included [byte]")
    output_bytes: int = Field(description="size of the files a client gets [byte]")
    seconds: float = Field(description="time on two cores, mesh included [s]")
    remarks: list[str] = Field(default_factory=list, description="settings that are not used, and why")
