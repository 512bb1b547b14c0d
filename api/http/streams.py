"""Streams of server-sent events: what happens to a row on lease, from its first event to its end."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import AsyncIterator
from typing import Annotated, Any

import anyio
from fastapi import Header
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from api.http.errors import ApiError
from tomosim_contract.names import EVENT_STATE, FINAL_STATES
from worker.records.database import AWAY
from worker.records.leases import Leases
from worker.records.rows import Event

log = logging.getLogger(__name__)

FIRST_POLL_SECONDS = 0.1
LONGEST_POLL_SECONDS = 0.5
"""The database is asked less often the longer nothing happens."""

HEARTBEAT_SECONDS = 15.0
RECONNECT_MILLISECONDS = 2000

STREAM: dict[int | str, Any] = {200: {"content": {"text/event-stream": {}}}}
RESUMED_STREAM: dict[int | str, Any] = {**STREAM, 400: {"description": "bad-event-id"}}
"""Answers of a route, for its description."""

LastEventId = Annotated[str | None, Header(description="the last event seen; a number")]


def answer(events: AsyncIterator[str]) -> StreamingResponse:
    """The response that sends events as they come."""
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(events, media_type="text/event-stream", headers=headers)


def sequence_of(last_event_id: str | None) -> int:
    if not last_event_id:
        return 0
    if last_event_id.isascii() and last_event_id.isdigit() and len(last_event_id) <= 9:
        return int(last_event_id)
    raise ApiError(400, "bad-event-id", f"Last-Event-ID = {last_event_id[:80]!r}: a number that this stream sent")


async def stream(leases: Leases[Any], identifier: str, sequence: int, path: str) -> AsyncIterator[str]:
    """The events of a row after ``sequence`` until its end; the final one names its ``path``."""
    yield f"retry: {RECONNECT_MILLISECONDS}\n\n"
    spoke = time.monotonic()
    pause = FIRST_POLL_SECONDS
    while True:
        events, ended = await run_in_threadpool(_news, leases, identifier, sequence)
        for event in events:
            sequence = event.sequence
            spoke = time.monotonic()
            pause = FIRST_POLL_SECONDS
            yield _format(event, leases.what, path)
        if ended:
            return
        if time.monotonic() - spoke > HEARTBEAT_SECONDS:
            spoke = time.monotonic()
            yield ": still here\n\n"
        await anyio.sleep(pause)
        pause = min(LONGEST_POLL_SECONDS, 1.2 * pause)


def _news(leases: Leases[Any], identifier: str, sequence: int) -> tuple[list[Event], bool]:
    """The events after ``sequence``, and whether none will follow. Where the database is away: none, and they may."""
    try:
        events = leases.events_after(identifier, sequence)
        row = leases.get(identifier)
    except LookupError:
        return [], True
    except AWAY as error:
        log.warning("the database does not answer: the stream waits", extra={"error": repr(error)})
        return [], False
    # The row says when there is nothing more to come: a retried case goes on after a final event, and a client that
    # has seen the last event must not wait for another.
    return events, bool(row.is_final and row.revision <= (events[-1].sequence if events else sequence))


def _format(event: Event, what: str, path: str) -> str:
    data = {**event.data, "at": event.at}
    if event.kind == EVENT_STATE and event.data.get("state") in FINAL_STATES:
        data[what] = path
    return f"id: {event.sequence}\nevent: {event.kind}\ndata: {json.dumps(data)}\n\n"
