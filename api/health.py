"""/livez, /readyz, /metrics: for those who run the service."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable

from fastapi import APIRouter
from fastapi.responses import JSONResponse, PlainTextResponse

from api.auth import Read
from api.deps import Served, Services
from api.errors import ApiError
from worker.contract import STATES

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


@router.get("/metrics")
def metrics(caller: Read, served: Served) -> PlainTextResponse:
    """Counts in the text format of Prometheus."""
    counts = served.fleet.counts()
    lines = [
        "# HELP tomosim_simulations Simulations by state.",
        "# TYPE tomosim_simulations gauge",
        *(f'tomosim_simulations{{state="{state}"}} {counts.get(state, 0)}' for state in STATES),
        "# HELP tomosim_queue_age_seconds Age of the oldest queued simulation.",
        "# TYPE tomosim_queue_age_seconds gauge",
        f"tomosim_queue_age_seconds {served.fleet.queue_age():.3f}",
        "# HELP tomosim_workers Workers heard of lately.",
        "# TYPE tomosim_workers gauge",
        f"tomosim_workers {served.fleet.alive()}",
        "# HELP tomosim_free_bytes Free space on the disk of the store.",
        "# TYPE tomosim_free_bytes gauge",
        f"tomosim_free_bytes {shutil.disk_usage(served.store.root).free}",
    ]
    return PlainTextResponse("\n".join(lines) + "\n", media_type="text/plain; version=0.0.4; charset=utf-8")


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
