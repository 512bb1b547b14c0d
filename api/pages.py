"""Cursors of lists: opaque to clients, the place of the last item for us."""

from __future__ import annotations

import base64
import json
import math

from api.errors import ApiError

Place = tuple[float, str]


def encode(place: Place) -> str:
    """The cursor that continues after this place (created, id)."""
    return base64.urlsafe_b64encode(json.dumps(place).encode()).decode().rstrip("=")


def decode(cursor: str) -> Place:
    """The place of a cursor. raises: ApiError 400 bad-cursor"""
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        created, identifier = json.loads(base64.b64decode(padded, altchars=b"-_", validate=True))
        if isinstance(created, float) and math.isfinite(created) and isinstance(identifier, str):
            return created, identifier
    except (ValueError, TypeError):
        pass
    raise ApiError(
        400,
        "bad-cursor",
        f"cursor = {cursor[:80]!r}: take it from the Link header or from 'next' of the page before",
    )
