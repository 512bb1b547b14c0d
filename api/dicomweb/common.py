"""What the routes of /dicomweb share: path parameters, the index, addresses, and instances that are really there."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Any

from fastapi import Depends, Path, Request
from starlette.datastructures import URL

from api.dicomweb.query import FRAMES, UID
from api.http.auth import Read
from api.http.deps import Services
from api.http.errors import MAX_SHOWN, ApiError
from worker.dicom_index.index import Instance
from worker.dicom_index.indexer import Indexer
from worker.records.retention import ExpiredError

PREFIX = "/dicomweb"


# Told, not enforced by the framework: a wrong identifier is answered with 400 as the standard says, not with 422.
_UID_FORM: dict[str, Any] = {"pattern": f"^{UID.pattern}$"}


def _checked(name: str, value: str) -> str:
    if not UID.fullmatch(value):
        raise ApiError(400, "bad-uid", f"{name} = {value[:MAX_SHOWN]!r}: 1 to 64 digits and dots are allowed")
    return value


def _study(study: Annotated[str, Path(description="Study Instance UID", json_schema_extra=_UID_FORM)]) -> str:
    return _checked("study", study)


def _series(series: Annotated[str, Path(description="Series Instance UID", json_schema_extra=_UID_FORM)]) -> str:
    return _checked("series", series)


def _instance(instance: Annotated[str, Path(description="SOP Instance UID", json_schema_extra=_UID_FORM)]) -> str:
    return _checked("instance", instance)


FrameList = Annotated[
    str,
    Path(description="numbers from 1 on, separated by commas", json_schema_extra={"pattern": f"^{FRAMES.pattern}$"}),
]
StudyUID = Annotated[str, Depends(_study)]
SeriesUID = Annotated[str, Depends(_series)]
InstanceUID = Annotated[str, Depends(_instance)]


def indexer(request: Request) -> Indexer:
    """The one that fills the index of this application."""
    running: Indexer = request.app.state.dicom_indexer
    return running


def reader(caller: Read) -> None:
    """raises: ApiError 401, 403 where the request must not read"""


Indexing = Annotated[Indexer, Depends(indexer)]


def base_url(request: Request) -> URL:
    """The address of the host as the client sees it."""
    base = request.base_url
    server = request.scope.get("server")
    forwarded = any(name in request.headers for name in ("forwarded", "x-forwarded-for", "x-forwarded-host"))
    if base.port is None and not forwarded and server is not None and server[1] not in (None, 80, 443):
        base = base.replace(port=server[1])  # dicomweb-client leaves the port out of Host
    return base


def service_url(request: Request) -> str:
    """The address of this service, without a slash at the end."""
    return str(base_url(request)).rstrip("/") + PREFIX


def resource_url(request: Request, study: str, series: str | None = None, instance: str | None = None) -> str:
    """The address of a study, series or instance."""
    url = f"{service_url(request)}/studies/{study}"
    if series is not None:
        url += f"/series/{series}"
    if instance is not None:
        url += f"/instances/{instance}"
    return url


def find(indexing: Indexer, study: str, series: str | None = None, instance: str | None = None) -> list[Instance]:
    """The objects of a resource. raises: ApiError 404 where there is none, ExpiredError (410)"""
    objects: list[Instance] = []
    with suppress(ExpiredError):
        objects = indexing.index.instances(study, series, instance)
    if not objects:
        indexing.catch_up()  # of a case that has just succeeded
        objects = indexing.index.instances(study, series, instance)
    if not objects:
        kind = "instance" if instance else "series" if series else "study"
        raise ApiError(404, f"{kind}-not-found", f"there is no {kind} {instance or series or study}")
    return objects


def require_files(served: Services, instances: list[Instance]) -> None:
    """raises: ApiError 410 where a file is not in the store any more"""
    for item in instances:
        if not served.store.has(item.file):
            raise ApiError(410, "expired", f"{item.name} is not in the store any more: post the case again")
