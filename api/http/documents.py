"""What the documents of every resource have in common."""

from __future__ import annotations

from datetime import UTC, datetime

PREFIX = "/v1"


def when(seconds: float) -> datetime:
    """Seconds since 1970 as a time in UTC."""
    return datetime.fromtimestamp(seconds, UTC)


def when_or_none(seconds: float | None) -> datetime | None:
    """The same of what may not have been."""
    return None if seconds is None else when(seconds)
