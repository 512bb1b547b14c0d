"""What both clients share besides their requests."""

from __future__ import annotations

import os
import time

import anyio.to_thread
import httpx

from simcore import __version__

run_in_thread = anyio.to_thread.run_sync

DEFAULT_URL = "http://127.0.0.1:8080"

LOOK_SECONDS = 1.0
"""Pause between two looks at what has no events."""

SILENT_SECONDS = 45.0
"""A stream of events shows a sign of life every quarter of a minute; one that does not is broken."""


def url_of(url: str | None) -> str:
    """The address of the service."""
    return (url or os.environ.get("TOMOSIM_URL") or DEFAULT_URL).rstrip("/")


def headers(api_key: str | None) -> dict[str, str]:
    """Headers of every request."""
    key = api_key or os.environ.get("TOMOSIM_API_KEY")
    return {
        "User-Agent": f"tomosim-client/{__version__}",
        "Accept-Encoding": "identity",  # files are stored as they are; a range counts their own bytes
        **({"Authorization": f"Bearer {key}"} if key else {}),
    }


class Deadline:
    """A time after which waiting ends. seconds: None for never."""

    def __init__(self, seconds: float | None) -> None:
        self.seconds = seconds
        self._end = None if seconds is None else time.monotonic() + seconds

    def check(self, what: str) -> None:
        """raises: TimeoutError"""
        if self._end is not None and time.monotonic() >= self._end:
            raise TimeoutError(f"{what} has not ended within {self.seconds:g} s; it goes on")

    def stream_timeout(self, usual_seconds: float) -> httpx.Timeout:
        """How long a stream may be silent."""
        left = SILENT_SECONDS if self._end is None else max(0.05, self._end - time.monotonic())
        return httpx.Timeout(usual_seconds, read=min(SILENT_SECONDS, left))
