"""Pages of other origins that may read /dicomweb: viewers such as OHIF."""

from __future__ import annotations

from collections.abc import Collection

from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Receive, Scope, Send

from api.dicomweb.common import PREFIX

EXPOSED = (
    "Content-Length",
    "Content-Location",
    "Content-Range",
    "Accept-Ranges",
    "ETag",
    "Link",
    "Warning",
    "WWW-Authenticate",
)
"""Headers of an answer that a page may see."""


class ViewerOrigins:
    """ASGI middleware: cross-origin answers below /dicomweb alone, for the origins that the settings name.

    A key comes in the Authorization header, which the page itself has to add; cookies play no part.
    """

    def __init__(self, app: ASGIApp, origins: Collection[str]) -> None:
        self.app = app
        self.sharing = CORSMiddleware(
            app,
            allow_origins=origins,
            allow_methods=("GET", "HEAD"),
            allow_headers=("*",),
            allow_private_network=True,
            expose_headers=EXPOSED,
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        inside = scope["type"] == "http" and scope["path"].startswith(f"{PREFIX}/")
        await (self.sharing if inside else self.app)(scope, receive, send)
