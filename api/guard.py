"""What a browser on this machine could be made to do: requests of other sites are refused.

Without keys the service trusts whoever reaches it on loopback. A page of another site in the same user's browser
reaches it as well: by a name that it lets point to 127.0.0.1 (the Host header tells), or by a form (Origin tells).
"""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.errors import ApiError, problem_response
from worker.settings import Settings, is_loopback

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")


class Guard:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.loopback_only = not settings.trusted_network

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
        host = headers.get("host", "")
        name = urlsplit(f"//{host}").hostname or ""
        if self.loopback_only and not is_loopback(name):
            return ApiError(403, "host-not-allowed", f"Host = {host[:100]!r}: ask for 127.0.0.1 or localhost")
        origin = headers.get("origin")
        if method not in SAFE_METHODS and origin is not None and urlsplit(origin).netloc != host:
            return ApiError(403, "cross-origin", f"Origin = {origin[:100]!r}: pages of other sites may only read")
        return None
