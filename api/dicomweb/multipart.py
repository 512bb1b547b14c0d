"""multipart/related answers, made while they are sent: nothing larger than a chunk is held."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from fastapi import Request, Response
from fastapi.responses import StreamingResponse

from api.dicomweb.accept import RELATED
from api.http.conditions import none_match
from api.http.files import byte_range

Chunks = Callable[[int, int], Iterator[bytes]]


@dataclass(frozen=True)
class Part:
    """A body. chunks(first, length): its bytes from ``first`` on, piece by piece. size: None where it is not known
    before it is read; such a part is sent whole, within multipart."""

    content_type: str
    size: int | None
    chunks: Chunks
    location: str | None = None

    @classmethod
    def of(cls, content_type: str, content: bytes, location: str | None = None) -> Part:
        """A part that is in memory."""
        return cls(content_type, len(content), lambda first, length: iter([content[first : first + length]]), location)


def multipart_response(request: Request, parts: Sequence[Part], media_type: str, tag: str) -> Response:
    """All parts as one multipart/related answer; ``tag`` changes with the content."""
    headers = _caching(tag)
    if none_match(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    boundary = uuid.uuid4().hex
    heads = [_head(boundary, part, first=number == 0) for number, part in enumerate(parts)]
    tail = f"\r\n--{boundary}--\r\n".encode()
    sizes = [part.size for part in parts]
    if None not in sizes:
        headers["Content-Length"] = str(sum(map(len, heads)) + sum(size or 0 for size in sizes) + len(tail))
    kind = f'{RELATED}; type="{media_type}"; boundary={boundary}'
    if request.method == "HEAD":
        return Response(headers=headers, media_type=kind)

    def body() -> Iterator[bytes]:
        for head, part in zip(heads, parts, strict=True):
            yield head
            yield from part.chunks(0, part.size or 0)
        yield tail

    return StreamingResponse(body(), headers=headers, media_type=kind)


def single_response(request: Request, part: Part, tag: str) -> Response:
    """One part of known size alone; byte ranges are served. raises: ApiError 416"""
    size = part.size or 0
    headers = _caching(tag) | {"Accept-Ranges": "bytes"}
    if none_match(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    if part.location is not None:
        headers["Content-Location"] = part.location
    span = None
    if request.headers.get("if-range", headers["ETag"]) == headers["ETag"]:
        span = byte_range(request.headers.get("range"), size)
    first, length = span or (0, size)
    headers["Content-Length"] = str(length)
    if span is not None:
        headers["Content-Range"] = f"bytes {first}-{first + length - 1}/{size}"
    status = 206 if span is not None else 200
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=part.content_type)
    return StreamingResponse(part.chunks(first, length), status, headers, media_type=part.content_type)


def _head(boundary: str, part: Part, first: bool) -> bytes:
    lines = [("" if first else "\r\n") + f"--{boundary}", f"Content-Type: {part.content_type}"]
    if part.location is not None:
        lines.append(f"Content-Location: {part.location}")
    if part.size is not None:
        lines.append(f"Content-Length: {part.size}")
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def _caching(tag: str) -> dict[str, str]:
    """An identifier names one content for ever, but the case may be deleted: caches ask again."""
    return {"ETag": f'"{tag}"', "Cache-Control": "private, no-cache", "Vary": "Accept"}
