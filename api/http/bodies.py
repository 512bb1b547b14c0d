"""Bodies. Small ones of JSON are read strictly, refused with the place and value of everything that is wrong."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request
from pydantic import BaseModel, ValidationError

from api.http.deps import services
from api.http.errors import ApiError
from simcore.spec import SimulationSpec

Model = TypeVar("Model", bound=BaseModel)

MAX_SHOWN = 200


async def posted(request: Request, model: type[Model]) -> Model:
    """The body of a request. raises: ApiError 413, 415, 422 naming every wrong field"""
    return parsed(await read_json(request), model)


def parsed(text: bytes, model: type[Model]) -> Model:
    """A document from JSON. raises: ApiError 422 naming every wrong field"""
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        items = [_item(dict(row)) for row in error.errors(include_url=False, include_context=False)]
        detail = "; ".join(f"{item['pointer'] or 'the body'}: {item['detail']}" for item in items)
        raise ApiError(422, "invalid-request", detail, errors=items) from None


def body_of(model: type[BaseModel]) -> dict[str, Any]:
    """The part of the OpenAPI description that tells of such a body."""
    schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}


def body_named(schema: str) -> dict[str, Any]:
    """The same of a body whose schema the description has under this name."""
    content = {"application/json": {"schema": {"$ref": f"#/components/schemas/{schema}"}}}
    return {"requestBody": {"required": True, "content": content}}


def _item(error: dict[str, Any]) -> dict[str, Any]:
    pointer = "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in error["loc"])
    value = error.get("input")
    if isinstance(value, str):
        value = value[:MAX_SHOWN]
    elif not isinstance(value, bool | int | None):
        value = None
    return {"pointer": pointer, "value": value, "detail": error["msg"]}


@dataclass(frozen=True)
class PostedCase:
    """A posted document: the specification, and what else it asks for. deliver: as JSON has it; None: not given."""

    specification: bytes
    deliver: Any


async def _posted_case(request: Request) -> PostedCase:
    """The body, taken apart: ``deliver`` is no part of what a case is. raises: ApiError 413, 415"""
    body = await read_json(request)
    if b'"deliver"' in body:
        try:
            document = json.loads(body)
        except ValueError:
            return PostedCase(body, None)  # reading the specification says what is wrong
        if isinstance(document, dict) and "deliver" in document:
            deliver = document.pop("deliver")
            return PostedCase(json.dumps(document).encode(), deliver)
    return PostedCase(body, None)


PostedCaseBody = Annotated[PostedCase, Depends(_posted_case)]


def _posted_specification(case: PostedCaseBody) -> SimulationSpec:
    """The specification in the body. raises: SpecError naming every wrong field"""
    return SimulationSpec.parse(case.specification)


def content_type(request: Request) -> str:
    """The media type of the body, without parameters; empty where none is given."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def read_json(request: Request) -> bytes:
    """The body of a request that must be JSON, not parsed. raises: ApiError 413, 415"""
    limit = services(request).settings.body_limit_bytes
    kind = content_type(request)
    if kind != "application/json" and not kind.endswith("+json"):
        # Also keeps out pages of other sites: a browser sends them JSON only after asking us.
        raise ApiError(415, "unsupported-media-type", f"Content-Type = {kind!r}: the body must be application/json")
    return await read_body(request, limit)


async def read_body(request: Request, limit: int) -> bytes:
    """The body of a request. raises: ApiError 413 as soon as it is longer than ``limit`` bytes"""
    too_large = ApiError(413, "too-large", f"the body is longer than the {limit} bytes that are allowed")
    announced = request.headers.get("content-length", "0")
    if announced.isdigit() and int(announced) > limit:
        raise too_large
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit:
            raise too_large
    return bytes(body)


PostedSpecification = Annotated[SimulationSpec, Depends(_posted_specification)]
