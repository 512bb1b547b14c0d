"""Idempotency-Key: a POST that is sent again does nothing again and gets the same answer.

A router with ``route_class=IdempotentRoute`` honours the header on its POST routes. A route that makes something takes
``making: Making``, gives ``making.identifier`` to what it makes, and where ``making.again`` looks first whether it is
there: the request before may have died after its commit.
"""

from __future__ import annotations

import hashlib
import logging
import re
import uuid
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from sqlalchemy.exc import IntegrityError, SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.types import Message

from api.http.auth import authenticate
from api.http.bodies import read_body
from api.http.deps import services
from api.http.errors import ApiError
from simcore.core.errors import SimulationError
from worker.records.idempotency import Claim, Idempotency, KeyBusyError, KeyReusedError
from worker.records.quotas import QuotaError
from worker.records.rows import NotFoundError

log = logging.getLogger(__name__)

HEADER = "Idempotency-Key"
KEPT_HEADERS = ("content-type", "location", "retry-after")

_KEY = re.compile(r"[\x21-\x7e]{1,255}")
_REFUSALS = (ApiError, SimulationError, HTTPException, RequestValidationError, NotFoundError, QuotaError)
"""What a route raises before it has done anything."""

Row = TypeVar("Row")

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


@dataclass(frozen=True)
class New:
    """What a request makes.

    identifier: for it. again: whether a request with the same key may have made it before.
    """

    identifier: str
    again: bool

    def earlier(self, get: Callable[[str], Row]) -> Row | None:
        """What a request with the same key has made; None where there was none, or it did not get so far."""
        try:
            return get(self.identifier) if self.again else None
        except NotFoundError:
            return None


def _making(
    request: Request,
    idempotency_key: Annotated[
        str | None,
        Header(
            min_length=1,
            max_length=255,
            pattern=r"^[\x21-\x7e]+$",
            description="any text of your own: the same request with the same key is done once and answered alike, "
            "for a day; 422 idempotency-key-reused for another request, 409 idempotency-in-progress meanwhile",
        ),
    ] = None,
) -> New:
    claim: Claim | None = getattr(request.state, "claim", None)
    return New(uuid.uuid4().hex, again=False) if claim is None else New(claim.identifier, claim.again)


Making = Annotated[New, Depends(_making)]


class IdempotentRoute(APIRoute):
    """A route that honours Idempotency-Key on POST."""

    def get_route_handler(self) -> Handler:
        handler = super().get_route_handler()
        if "POST" not in (self.methods or ()):
            return handler

        async def once(request: Request) -> Response:
            key = request.headers.get(HEADER)
            if key is None or not _KEY.fullmatch(key):
                return await handler(request)  # which refuses a key that is none
            return await _once(handler, request, key)

        return once


async def _once(handler: Handler, request: Request, key: str) -> Response:
    served = services(request)
    body = await read_body(request, served.settings.body_limit_bytes)
    claim = await run_in_threadpool(_claim, served.idempotency, request, key, body)
    if claim.answer is not None:
        return _replayed(claim.answer)
    request = _with_body(request, body)
    request.state.claim = claim
    try:
        response = await handler(request)
    except _REFUSALS:
        await run_in_threadpool(served.idempotency.release, claim)
        raise
    except IntegrityError as error:
        # The request before was not dead but slow, and has made it just now.
        raise _in_progress(key) from error
    except Exception:
        await run_in_threadpool(served.idempotency.abandon, claim)
        raise
    await run_in_threadpool(_keep, served.idempotency, claim, response)
    return response


def _claim(keys: Idempotency, request: Request, key: str, body: bytes) -> Claim:
    digest = hashlib.sha256(f"{request.method} {request.url.path}?{request.url.query}\n".encode() + body)
    try:
        return keys.claim(authenticate(request).id, key, digest.hexdigest())
    except KeyReusedError:
        raise ApiError(
            422,
            "idempotency-key-reused",
            f"{HEADER} = {key[:80]!r} was used with another request: take a new key for a new request",
        ) from None
    except KeyBusyError:
        raise _in_progress(key) from None


def _in_progress(key: str) -> ApiError:
    detail = f"a request with {HEADER} = {key[:80]!r} is under way: ask again for its answer"
    return ApiError(409, "idempotency-in-progress", detail, headers={"Retry-After": "1"})


def _keep(keys: Idempotency, claim: Claim, response: Response) -> None:
    """Keeps an answer. Where that fails the deed is done all the same: who repeats it finds what was made."""
    headers = {name: value for name in KEPT_HEADERS if (value := response.headers.get(name)) is not None}
    answer = {"status": response.status_code, "headers": headers, "body": bytes(response.body).decode()}
    try:
        keys.answer(claim, answer)
    except SQLAlchemyError:
        log.exception("answer not kept", extra={"path": claim.key})


def _replayed(answer: dict[str, Any]) -> Response:
    headers = {**answer["headers"], "Idempotency-Replayed": "true"}
    return Response(answer["body"], answer["status"], headers)


def _with_body(request: Request, body: bytes) -> Request:
    """The request, with a body that was read already."""
    unread = [body]

    async def receive() -> Message:
        if unread:
            return {"type": "http.request", "body": unread.pop(), "more_body": False}
        return await request.receive()

    return Request(request.scope, receive)
