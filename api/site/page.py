"""/: a small page for people: all cases, their progress, the pictures of finished ones."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import HTMLResponse

PAGE = Path(__file__).parent / "web" / "index.html"

router = APIRouter(include_in_schema=False)


@router.get("/")
def index() -> HTMLResponse:
    """The page."""
    content, policy = _page()
    return HTMLResponse(content, headers={"Content-Security-Policy": policy, "Cache-Control": "no-cache"})


@cache
def _page() -> tuple[str, str]:
    """The page and its policy: its own script and style by their digests, everything else from here alone."""
    content = PAGE.read_text(encoding="utf-8")
    policy = (
        f"default-src 'none'; connect-src 'self'; img-src 'self' data:; script-src {_digests('script', content)}; "
        f"style-src {_digests('style', content)}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return content, policy


def _digests(tag: str, content: str) -> str:
    bodies = re.findall(rf"<{tag}>(.*?)</{tag}>", content, re.DOTALL)
    hashes = (base64.b64encode(hashlib.sha256(body.encode()).digest()).decode() for body in bodies)
    return " ".join(f"'sha256-{h}'" for h in hashes)
