"""Why something failed, as answers say it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field


class FailureResource(BaseModel):
    """Why a case failed."""

    kind: Literal["user", "simulation", "system"] = Field(
        description="user: change the specification; simulation: the numerics failed; system: retry"
    )
    code: str = Field(description="stable, machine-readable")
    message: str
    problems: list[dict[str, Any]] = []
