"""Every request has an identifier: X-Request-Id of the client where it is sane, else a new one. It stands in the
answer, in problem documents, in all log lines and in the row of what the request made."""

from __future__ import annotations

import logging
import re
import time
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.http.errors import ApiError, problem_response
from worker import logs

HEADER = "X-Request-Id"

_SANE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:/+=@-]{0,127}")

_QUIET_METHODS = ("GET", "HEAD", "OPTIONS")

log = logging.getLogger(__name__)


class Requests:
    """ASGI middleware, the outermost: identifier, one log line a request, and an answer to what nobody caught."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        value = Headers(scope=scope).get(HEADER, "")
        identifier = value if _SANE.fullmatch(value) else uuid.uuid4().hex
        # Not taken back in the end: the server's own lines about this request come later, in the same task.
        logs.add(request=identifier)
        started = time.monotonic()
        status = 0

        async def send_identified(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[HEADER] = identifier
            await send(message)

        try:
            await self.app(scope, receive, send_identified)
        except Exception:
            log.exception("request failed", extra={"method": scope["method"], "path": scope["path"]})
            if status == 0:
                detail = f"a mistake in tomosim; the log of the API has the details (request {identifier})"
                answer = problem_response(scope["path"], ApiError(500, "internal-error", detail))
                await answer(scope, receive, send_identified)
            raise
        finally:
            _tell(scope, status, time.monotonic() - started)


def _tell(scope: Scope, status: int, seconds: float) -> None:
    """One line; reading at level debug: pages and monitors ask every second."""
    level = logging.DEBUG if scope["method"] in _QUIET_METHODS and status < 500 else logging.INFO
    principal = scope.get("state", {}).get("principal")
    fields = {
        "method": scope["method"],
        "path": scope["path"],
        "status": status,
        "seconds": round(seconds, 4),
        "key": principal.id if principal is not None else None,
    }
    log.log(level, "request", extra=fields)
