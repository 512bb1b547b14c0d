"""What a browser could be made to do by a page of another site: requests that change something are refused.

A browser adds by itself that it is on this machine, and the password that it was told. Origin says which page asks.
A bearer key is never added by itself. (A foreign name that points to this machine: ``api.http.auth``.)
"""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.http.errors import ApiError, problem_response

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")


class Guard:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if refusal := self._refusal(scope["method"], Headers(scope=scope)):
            await problem_response(scope["path"], refusal)(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).setdefault("X-Content-Type-Options", "nosniff")
            await send(message)

        await self.app(scope, receive, send_guarded)

    def _refusal(self, method: str, headers: Headers) -> ApiError | None:
        origin = headers.get("origin")
        if method in SAFE_METHODS or origin is None or headers.get("authorization", "").lower().startswith("bearer "):
            return None
        if _netloc(origin) == headers.get("host", ""):
            return None
        return ApiError(403, "cross-origin", f"Origin = {origin[:100]!r}: pages of other sites may only read")


def _netloc(origin: str) -> str | None:
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return None
