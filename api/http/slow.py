"""Bodies that trickle in: a client that is silent, or sends next to nothing, does not keep a request open for ever."""

from __future__ import annotations

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.http.errors import ApiError

GRACE_SECONDS = 30.0
MIN_BYTES_PER_SECOND = 1000.0


class SlowBodies:
    """ASGI middleware: 408 for a body that takes longer than the grace and what it has sent so far allow."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = asyncio.get_running_loop().time()
        received = 0
        complete = False

        async def receive_in_time() -> Message:
            nonlocal received, complete
            if complete:
                return await receive()
            try:
                async with asyncio.timeout_at(started + GRACE_SECONDS + received / MIN_BYTES_PER_SECOND):
                    message = await receive()
            except TimeoutError:
                raise ApiError(
                    408,
                    "too-slow",
                    f"the body comes too slowly ({received} bytes so far): at least {MIN_BYTES_PER_SECOND:g} bytes "
                    "a second are expected",
                    headers={"Connection": "close"},
                ) from None
            received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            return message

        await self.app(scope, receive_in_time, send)
