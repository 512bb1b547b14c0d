"""Taking large bodies: written to the disk as they come."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from api.http.errors import ApiError


async def receive(request: Request, target: Path, limit: int) -> None:
    """Writes the body to a file. raises: ApiError 413 as soon as it is longer than ``limit`` bytes"""
    file: IO[bytes] = await run_in_threadpool(open, target, "wb")  # type: ignore[arg-type]
    try:
        received = 0
        async for chunk in request.stream():
            received += len(chunk)
            check_size(received, limit)
            await run_in_threadpool(file.write, chunk)
    finally:
        await run_in_threadpool(file.close)


def check_size(size: int, limit: int) -> None:
    if size > limit:
        raise ApiError(413, "too-large", f"the body is longer than the {limit} bytes that are allowed")
