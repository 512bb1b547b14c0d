"""Files of the store over HTTP: byte ranges, entity tags and digests (RFC 9110, RFC 9530)."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from fastapi import Request, Response
from fastapi.responses import StreamingResponse

from api.http.conditions import none_match, require_match
from api.http.errors import ApiError
from simcore.store.hashing import FileRef
from simcore.store.store import Store

CHUNK_BYTES = 1 << 20

# No more digits than int() takes from strangers.
_RANGE = re.compile(r"bytes\s*=\s*([0-9]{0,40})\s*-\s*([0-9]{0,40})\s*", re.IGNORECASE)

MEDIA_TYPES = {
    ".dcm": "application/dicom",
    ".json": "application/json",
    ".png": "image/png",
    ".csv": "text/csv; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
}

ANY = "application/octet-stream"

ALL_MEDIA_TYPES = (*MEDIA_TYPES.values(), ANY)


def media_type(name: str) -> str:
    """Media type of a file, by its name."""
    return MEDIA_TYPES.get(Path(name).suffix.lower(), ANY)


def read_chunks(path: Path, start: int = 0, length: int | None = None) -> Iterator[bytes]:
    """The content of a file, piece by piece."""
    with open(path, "rb") as f:
        f.seek(start)
        left = path.stat().st_size - start if length is None else length
        while left > 0 and (chunk := f.read(min(CHUNK_BYTES, left))):
            left -= len(chunk)
            yield chunk


def byte_range(header: str | None, size: int) -> tuple[int, int] | None:
    """(first byte, length) of a Range header; None where the whole file is the answer.

    What is not a byte range, and a request for several, is answered with the whole file, as RFC 9110 allows.
    raises: ApiError 416 where the range lies outside.
    """
    match = _RANGE.fullmatch(header.strip()) if header else None
    if match is None or match.groups() == ("", ""):
        return None
    first, last = match.groups()
    if first == "":  # the last bytes
        length = min(int(last), size)
        start = size - length
    else:
        start = int(first)
        if last and int(last) < start:
            return None
        length = min(int(last) if last else size, size - 1) - start + 1
    if length <= 0:
        raise ApiError(
            416,
            "range-not-satisfiable",
            f"Range = {header!r}: the file has {size} bytes",
            headers={"Content-Range": f"bytes */{size}"},
        )
    return start, length


def file_response(request: Request, store: Store, ref: FileRef, name: str) -> Response:
    """The answer to GET of a stored file.

    raises: ApiError 410 where it is not in the store any more, 412, 416
    """
    kind = media_type(name)
    headers = {
        "ETag": f'"{ref.sha256}"',
        "Repr-Digest": f"sha-256=:{base64.b64encode(bytes.fromhex(ref.sha256)).decode()}:",
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, max-age=31536000, immutable",
    }
    require_match(request.headers.get("if-match"), headers["ETag"])
    if none_match(request.headers.get("if-none-match"), ref.sha256):
        return Response(status_code=304, headers=headers)
    if not store.has(ref):
        raise ApiError(410, "expired", f"{name} is not in the store any more: post the case again to make it anew")
    shown = "inline" if kind.startswith("image/") else "attachment"
    headers["Content-Disposition"] = f"{shown}; {_file_name(name)}"
    part = None
    if request.headers.get("if-range", headers["ETag"]) == headers["ETag"]:
        part = byte_range(request.headers.get("range"), ref.size)
    start, length = part or (0, ref.size)
    headers["Content-Length"] = str(length)
    status = 200
    if part is not None:
        status = 206
        headers["Content-Range"] = f"bytes {start}-{start + length - 1}/{ref.size}"
    return StreamingResponse(store.stream(ref, start, length), status, headers, media_type=kind)


def _file_name(name: str) -> str:
    last = name.rsplit("/", 1)[-1]
    encoded = quote(last)
    return f'filename="{last}"' if encoded == last else f"filename*=utf-8''{encoded}"
