"""Errors as application/problem+json (RFC 9457) with a stable ``code``."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.routing import Match

from simcore.core.errors import ResourceLimitError, SimulationError, SpecError, StoreError
from worker import logs
from worker.records.database import AWAY
from worker.records.quotas import QuotaError
from worker.records.retention import ExpiredError
from worker.records.rows import NotFoundError

log = logging.getLogger(__name__)

SOON = {"Retry-After": "5"}

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")

MAX_SHOWN = 200
"""Characters of a refused value that are repeated in an answer."""

_CODES = {404: "not-found", 405: "method-not-allowed", 413: "too-large", 415: "unsupported-media-type"}


class ProblemItem(BaseModel):
    """One thing that is wrong: where it stands and what is allowed."""

    pointer: str | None = Field(None, description="JSON Pointer (RFC 6901) into the body")
    parameter: str | None = Field(None, description="name of the query parameter or header")
    value: Any = None
    detail: str
    case: int | None = Field(None, description="number of the first case of a study that is concerned")
    cases: int | None = Field(None, description="number of cases of a study that are concerned")


class Problem(BaseModel):
    """Body of every error answer."""

    type: str
    title: str
    status: int
    code: str = Field(description="stable, machine-readable")
    detail: str
    instance: str
    request_id: str | None = Field(None, description="X-Request-Id of this answer; log lines carry it")
    errors: list[ProblemItem] = []


class ApiError(Exception):
    """An error answer."""

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        *,
        errors: list[dict[str, Any]] | None = None,
        headers: Mapping[str, str] | Iterable[tuple[str, str]] = (),
        **more: Any,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.code = code
        self.detail = detail
        self.errors = errors
        self.headers = list(headers.items() if isinstance(headers, Mapping) else headers)
        self.more = more


def problem_response(path: str, error: ApiError) -> JSONResponse:
    """The answer for an error at ``path``."""
    body = {
        "type": f"urn:tomosim:problem:{error.code}",
        "title": HTTPStatus(error.status).phrase,
        "status": error.status,
        "code": error.code,
        "detail": error.detail,
        "instance": path,
        **({"request_id": identifier} if (identifier := logs.field("request")) else {}),
        **({"errors": error.errors} if error.errors else {}),
        **error.more,
    }
    response = JSONResponse(body, error.status, media_type="application/problem+json")
    for name, value in error.headers:
        response.headers.append(name, value)
    return response


def from_simulation_error(error: SimulationError) -> ApiError:
    """What a client is told where simcore refuses a request."""
    if isinstance(error, SpecError):
        code = "resource-limit" if isinstance(error, ResourceLimitError) else "invalid-request"
        return ApiError(422, code, str(error), errors=[_problem_item(p) for p in error.problems], reason=error.code)
    if isinstance(error, StoreError) and error.code == "storage-full":
        return ApiError(507, "storage-full", str(error))
    if isinstance(error, StoreError) and error.code == "store-unavailable":
        return ApiError(503, "store-unavailable", str(error), headers=SOON)
    return ApiError(500, error.code, str(error))


def _problem_item(problem: dict[str, Any]) -> dict[str, Any]:
    field = str(problem["field"])
    # Field names have neither "/" nor "~", so nothing has to be escaped. The whole document is "".
    pointer = "" if field.startswith("(") else "/" + field.replace(".", "/")
    pointer = problem.get("pointer", pointer)
    return {"pointer": pointer, "value": shown(problem.get("value")), "detail": problem["message"]}


def shown(value: Any) -> Any:
    """A refused value as JSON can say it, and not too long."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value[:MAX_SHOWN] if isinstance(value, str) else value


def allowed_methods(request: Request) -> list[str]:
    """The methods of all routes on this path (a router tells only those of the first one it finds)."""
    routes = request.app.router.routes
    methods = [
        method
        for method in METHODS
        if any(route.matches({**request.scope, "method": method})[0] == Match.FULL for route in routes)
    ]
    return sorted({*methods, "HEAD"}, key=METHODS.index) if "GET" in methods else methods


def install(app: FastAPI) -> None:
    """Makes every error of ``app`` a problem document."""

    @app.exception_handler(ApiError)
    async def _api_error(request: Request, error: ApiError) -> Response:
        return problem_response(request.url.path, error)

    @app.exception_handler(NotFoundError)
    async def _not_found(request: Request, error: NotFoundError) -> Response:
        answer = ApiError(404, f"{error.what}-not-found", f"there is no {error.what} {str(error)[:MAX_SHOWN]}")
        return problem_response(request.url.path, answer)

    @app.exception_handler(ExpiredError)
    async def _expired(request: Request, error: ExpiredError) -> Response:
        detail = f"{error} were kept until a time that has passed: post it again to make them anew"
        return problem_response(request.url.path, ApiError(410, "expired", detail))

    @app.exception_handler(SimulationError)
    async def _simulation_error(request: Request, error: SimulationError) -> Response:
        return problem_response(request.url.path, from_simulation_error(error))

    @app.exception_handler(HTTPException)
    async def _http_error(request: Request, error: HTTPException) -> Response:
        headers = dict(error.headers or {})
        detail = str(error.detail)
        if error.status_code == 404:
            detail = f"there is nothing at {request.url.path}"
        if error.status_code == 405:
            headers["Allow"] = ", ".join(allowed_methods(request))
            detail = f"{request.method} is not possible here; allowed: {headers['Allow']}"
        code = _CODES.get(error.status_code, f"http-{error.status_code}")
        return problem_response(request.url.path, ApiError(error.status_code, code, detail, headers=headers))

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> Response:
        items = [
            {"parameter": str(item["loc"][-1]), "value": shown(item.get("input")), "detail": item["msg"]}
            for item in error.errors()
        ]
        detail = "; ".join(f"{item['parameter']} = {item['value']!r}: {item['detail']}" for item in items)
        return problem_response(request.url.path, ApiError(422, "invalid-request", detail, errors=items))

    async def _database(request: Request, error: Exception) -> Response:
        log.error("the database does not answer", extra={"error": repr(error)})
        answer = ApiError(503, "database-unavailable", "the database does not answer: try again", headers=SOON)
        return problem_response(request.url.path, answer)

    for away in AWAY:
        app.add_exception_handler(away, _database)

    @app.exception_handler(QuotaError)
    async def _quota(request: Request, error: QuotaError) -> Response:
        headers = {} if error.retry_after is None else {"Retry-After": str(error.retry_after)}
        return problem_response(request.url.path, ApiError(429, "quota", str(error), headers=headers))
