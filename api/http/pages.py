"""Lists page by page. A cursor is opaque to clients; for us it is the place of the last item."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Query, Request, Response

from api.http.errors import ApiError

Place = tuple[float, str]
"""(created, id), or whatever else puts the rows in order."""

Row = TypeVar("Row", bound=Any)


def _by_age(row: Any) -> Place:
    return row.created, row.id


@dataclass(frozen=True)
class Page:
    """The part of a list that is asked for."""

    request: Request
    response: Response
    limit: int
    cursor: str | None

    @property
    def before(self) -> Place | None:
        """The place of the last item of the page before; None at the beginning. raises: ApiError 400 bad-cursor"""
        return None if self.cursor is None else decode(self.cursor)

    @property
    def rows(self) -> int:
        """How many rows to read: one more than are shown says whether another page follows."""
        return self.limit + 1

    def shown(self, rows: Sequence[Row], place: Callable[[Row], Place] = _by_age) -> tuple[Sequence[Row], str | None]:
        """The rows of this page, and the cursor of the next one, which the Link header has as well."""
        if len(rows) <= self.limit:
            return rows, None
        following = encode(place(rows[self.limit - 1]))
        self.response.headers["Link"] = f'<{self.request.url.include_query_params(cursor=following)}>; rel="next"'
        return rows[: self.limit], following


_CURSOR = Query(description="from the page before; anything else: 400 bad-cursor")


def page_of(usual: int, most: int) -> Callable[..., Page]:
    """A dependency that reads ``limit`` and ``cursor``."""
    limits = Query(usual, ge=1, le=most)

    def page(
        request: Request, response: Response, limit: int = limits, cursor: Annotated[str | None, _CURSOR] = None
    ) -> Page:
        return Page(request, response, limit, cursor)

    return page


AskedPage = Annotated[Page, Depends(page_of(50, 200))]


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
