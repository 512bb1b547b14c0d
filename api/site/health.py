"""/livez, /readyz: for those who run the service."""

from __future__ import annotations

import logging
from collections.abc import Callable

from fastapi import APIRouter
from fastapi.responses import JSONResponse

from api.http.deps import Served, Services
from api.http.errors import ApiError

log = logging.getLogger(__name__)

router = APIRouter(tags=["health"])


@router.get("/livez")
async def livez() -> dict[str, str]:
    """The process answers. Touches nothing."""
    return {"status": "ok"}


@router.get("/readyz")
def readyz(served: Served) -> JSONResponse:
    """Whether cases can be taken and computed: database, broker, storage, a worker heard of lately."""
    checks: dict[str, Callable[[Services], None]] = {
        "database": _database,
        "broker": _broker,
        "storage": _storage,
        "worker": _worker,
    }
    wrong = {name: problem for name, check in checks.items() if (problem := _problem(check, served))}
    if wrong:
        raise ApiError(
            503,
            "not-ready",
            "; ".join(f"{name}: {problem}" for name, problem in wrong.items()),
            headers={"Retry-After": "2"},
            checks={name: wrong.get(name, "ok") for name in checks},
        )
    return JSONResponse({"status": "ok", "checks": dict.fromkeys(checks, "ok")})


def _problem(check: Callable[[Services], None], served: Services) -> str | None:
    try:
        check(served)
    except Exception as error:
        log.warning("not ready", extra={"check": check.__name__, "error": repr(error)})
        return str(error).splitlines()[0] if str(error) else type(error).__name__
    return None


def _database(served: Services) -> None:
    served.fleet.ping()


def _broker(served: Services) -> None:
    served.messenger.ping()


def _storage(served: Services) -> None:
    served.store.require_space(0)
    served.store.check()


def _worker(served: Services) -> None:
    if not served.fleet.alive():
        raise RuntimeError("no worker was heard of lately: is one running?")
