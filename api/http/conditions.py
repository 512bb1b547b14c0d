"""Conditional requests: entity tags (RFC 9110, sections 8.8.3 and 13)."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Annotated

from fastapi import Header, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from api.http.errors import ApiError

_TAG = re.compile(r'(W/)?"([^"]*)"')

IfMatch = Annotated[str | None, Header(description="only where it has this (strong) entity tag; else 412")]
IfNoneMatch = Annotated[str | None, Header(description="304 where it still has this entity tag")]

CHANGED: dict[int | str, dict[str, str]] = {412: {"description": "changed-meanwhile: If-Match names another tag"}}
UNCHANGED: dict[int | str, dict[str, str]] = {304: {"description": "not changed"}}


def none_match(header: str | None, tag: str) -> bool:
    """Whether If-None-Match names the current entity tag (weak comparison): the answer is then 304.

    tag: the opaque part, without quotes.
    """
    if header is None:
        return False
    return header.strip() == "*" or tag in [opaque for _, opaque in _TAG.findall(header)]


def require_match(header: str | None, tag: str) -> None:
    """Where If-Match is given, it must name the current entity tag (strong comparison).

    tag: as ETag has it. raises: ApiError 412
    """
    if header is None or header.strip() == "*":
        return
    weak = tag.startswith("W/")
    if not weak and ("", tag.strip('"')) in _TAG.findall(header):
        return
    reason = " and weak tags never match: what is under way changes all the time" if weak else ": read it again"
    raise ApiError(412, "changed-meanwhile", f"If-Match = {header[:100]}: the entity tag is {tag} now{reason}")


def document(
    content: BaseModel, if_none_match: str | None = None, headers: Mapping[str, str] | None = None
) -> Response:
    """The answer to GET of a document, or 304. Its entity tag is strong: the digest of what is sent."""
    answer = JSONResponse(content.model_dump(mode="json"))
    tag = hashlib.sha256(bytes(answer.body)).hexdigest()[:32]
    sent = {**(headers or {}), "ETag": f'"{tag}"', "Cache-Control": "no-cache"}
    if none_match(if_none_match, tag):
        return Response(status_code=304, headers=sent)
    answer.headers.update(sent)
    return answer
