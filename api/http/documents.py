"""What the documents of every resource have in common. Imported by clients: no server, no database."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Literal

from pydantic import BaseModel, Field

PREFIX = "/v1"


class FailureResource(BaseModel):
    """Why a case failed."""

    kind: Literal["user", "simulation", "system"] = Field(
        description="user: change the specification; simulation: the numerics failed; system: retry"
    )
    code: str = Field(description="stable, machine-readable")
    message: str
    problems: list[dict[str, Any]] = []


def when(seconds: float) -> datetime:
    """Seconds since 1970 as a time in UTC."""
    return datetime.fromtimestamp(seconds, UTC)


def when_or_none(seconds: float | None) -> datetime | None:
    """The same of what may not have been."""
    return None if seconds is None else when(seconds)
