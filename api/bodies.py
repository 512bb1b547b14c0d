"""Small JSON bodies: read strictly, refused with the place and value of everything that is wrong."""

from __future__ import annotations

from typing import Any, TypeVar

from fastapi import Request
from pydantic import BaseModel, ValidationError

from api.deps import read_body, services
from api.errors import ApiError

Model = TypeVar("Model", bound=BaseModel)

MAX_SHOWN = 200


async def posted(request: Request, model: type[Model]) -> Model:
    """The body of a request. raises: ApiError 413, 415, 422 naming every wrong field"""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json" and not kind.endswith("+json"):
        raise ApiError(415, "unsupported-media-type", f"Content-Type = {kind!r}: the body must be application/json")
    return parsed(await read_body(request, services(request).settings.body_limit_bytes), model)


def parsed(text: bytes, model: type[Model]) -> Model:
    """A document from JSON. raises: ApiError 422 naming every wrong field"""
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        items = [_item(dict(found)) for found in error.errors(include_url=False, include_context=False)]
        detail = "; ".join(f"{item['pointer'] or 'the body'}: {item['detail']}" for item in items)
        raise ApiError(422, "invalid-request", detail, errors=items) from None


def body_of(model: type[BaseModel]) -> dict[str, Any]:
    """The part of the OpenAPI description that tells of such a body."""
    schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}


def _item(found: dict[str, Any]) -> dict[str, Any]:
    pointer = "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in found["loc"])
    value = found.get("input")
    if isinstance(value, str):
        value = value[:MAX_SHOWN]
    elif not isinstance(value, bool | int | None):
        value = None
    return {"pointer": pointer, "value": value, "detail": found["msg"]}
