"""/v1/simulations/{id}/events: what happens to a case, as server-sent events."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse

from api.http.auth import Read
from api.http.deps import Identifier, Served
from api.http.streams import STREAM_HEADERS, sequence_of, stream
from api.simulations.resources import simulation_path

router = APIRouter(prefix="/simulations", tags=["simulations"])


@router.get(
    "/{identifier}/events",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {}}}, 400: {"description": "bad-event-id"}},
)
def events(
    caller: Read,
    identifier: Identifier,
    served: Served,
    last_event_id: Annotated[str | None, Header(description="the last event seen; a number")] = None,
) -> StreamingResponse:
    """Events ``state`` and ``progress`` from the first (or after Last-Event-ID) to the final state."""
    served.jobs.get(identifier)
    return StreamingResponse(
        stream(served.jobs, identifier, sequence_of(last_event_id), simulation_path(identifier)),
        media_type="text/event-stream",
        headers=STREAM_HEADERS,
    )
