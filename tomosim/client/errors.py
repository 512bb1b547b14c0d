"""What can go wrong between a client and the service, one class for each thing that callers do about it.

Every error has the service's stable ``code`` and, where there was an answer, its ``status`` and problem document.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import httpx

from simcore.core.errors import SimulationError

Kind = Literal["user", "simulation", "system"]


class ServiceError(SimulationError):
    """The service said no, or could not be reached.

    status: of HTTP; None where no answer came. problem: the problem+json answer, empty where there is none.
    """

    kind: ClassVar[Kind] = "system"
    code = "service-error"

    def __init__(
        self,
        message: str,
        *,
        code: str | None = None,
        status: int | None = None,
        problem: dict[str, Any] | None = None,
        retry_after_seconds: float | None = None,
    ) -> None:
        super().__init__(message, code=code)
        self.status = status
        self.problem = problem or {}
        self.retry_after_seconds = retry_after_seconds


class UnreachableError(ServiceError):
    """No answer came: the service is not running, the address is wrong, or the connection broke."""

    code = "service-unreachable"


class InvalidRequestError(ServiceError):
    """400, 413, 415, 422: the request is wrong or asks for too much; ``problem["errors"]`` names the fields."""

    kind = "user"


class NotAuthenticatedError(ServiceError):
    """401: an API key is needed, or this one is not valid (any more)."""

    kind = "user"


class NotAllowedError(ServiceError):
    """403: the key may not do this."""

    kind = "user"


class NotFoundError(ServiceError):
    """404: there is nothing of this name."""

    kind = "user"


class ConflictError(ServiceError):
    """409, 412: not possible in the state it is in."""

    kind = "user"


class GoneError(ServiceError):
    """410: it was there, and has expired."""


class TooManyRequestsError(ServiceError):
    """429: a quota or rate is used up; ``retry_after_seconds`` says when to ask again."""


class UnavailableError(ServiceError):
    """502, 503, 504: not now."""


class StorageFullError(ServiceError):
    """507: the service has no space left."""


class DigestError(ServiceError):
    """A file arrived with another content than announced."""

    code = "digest-mismatch"


_BY_STATUS: dict[int, type[ServiceError]] = {
    400: InvalidRequestError,
    401: NotAuthenticatedError,
    403: NotAllowedError,
    404: NotFoundError,
    409: ConflictError,
    410: GoneError,
    412: ConflictError,
    413: InvalidRequestError,
    415: InvalidRequestError,
    422: InvalidRequestError,
    429: TooManyRequestsError,
    502: UnavailableError,
    503: UnavailableError,
    504: UnavailableError,
    507: StorageFullError,
}


def from_response(response: httpx.Response) -> ServiceError:
    """The error of an answer (whose body was read)."""
    try:
        problem = response.json()
    except ValueError:
        problem = None
    if not isinstance(problem, dict):
        problem = {}
    text = str(problem.get("detail") or problem.get("title") or response.text[:500] or response.reason_phrase)
    for item in problem.get("errors") or []:
        if (said := str(item.get("detail", ""))) not in text:
            text += f"; {item.get('pointer') or item.get('parameter') or ''}: {said}"
    error_class = _BY_STATUS.get(response.status_code, ServiceError)
    return error_class(
        text,
        code=problem.get("code") or f"http-{response.status_code}",
        status=response.status_code,
        problem=problem,
        retry_after_seconds=retry_after(response),
    )


def from_transport(url: str, error: httpx.HTTPError) -> UnreachableError:
    """The error of a request that got no answer."""
    if isinstance(error, httpx.ConnectError):
        return UnreachableError(
            f"no service answers at {url}: start one with 'tomosim serve', or name it with --url or TOMOSIM_URL"
        )
    return UnreachableError(f"{url}: {error or type(error).__name__}")


def retry_after(response: httpx.Response) -> float | None:
    """Seconds of the header Retry-After; None where it is not there or is a date."""
    value = response.headers.get("retry-after", "")
    return float(value) if value.isascii() and value.isdigit() else None
