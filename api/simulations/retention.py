"""How long the files of what is posted are kept."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query

from api.http.deps import Served


def _retention(
    served: Served,
    retention_seconds: Annotated[
        float | None,
        Query(
            ge=0,
            le=1e10,
            description="the files are kept so long after the end [s]; 0: for ever; not given: as the service does",
        ),
    ] = None,
) -> float | None:
    seconds = served.settings.retention_seconds if retention_seconds is None else retention_seconds
    return seconds or None


AskedRetention = Annotated[float | None, Depends(_retention)]
"""Seconds for which the files of what is posted are kept; None: for ever."""
