"""/v1/simulations: post, look, cancel, retry, forget."""

from __future__ import annotations

import logging
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse

from api import pages
from api.auth import Read, Submitting, Write
from api.automatic import BODY_WITH_DELIVER, WantedDeliveries, require_deliver
from api.conditions import CHANGED, UNCHANGED, IfMatch, IfNoneMatch, document, none_match, require_match
from api.deps import Identifier, PostedSpecification, Served, Services
from api.errors import ApiError
from api.idempotency import IdempotentRoute, Making
from api.resources import SimulationPage, SimulationResource, simulation_path, simulation_resource
from api.retention import AskedRetention
from simcore import estimate
from simcore.estimate import Estimate
from simcore.phantom.upload import registry
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.spec import SimulationSpec
from worker.contract import Device, Priority, Queue, State, queue_of
from worker.records.jobs import Simulation
from worker.records.rows import NotFoundError, StateError

log = logging.getLogger(__name__)

RETRY_AFTER = {"Retry-After": "1"}
"""Seconds after which it is worth looking again."""

_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/SimulationSpec"}}},
    }
}

router = APIRouter(prefix="/simulations", tags=["simulations"], route_class=IdempotentRoute)


@router.post("", status_code=202, openapi_extra=BODY_WITH_DELIVER)
def create(
    caller: Write,
    submitter: Submitting,
    specification: PostedSpecification,
    wanted: WantedDeliveries,
    served: Served,
    making: Making,
    retention: AskedRetention,
    request: Request,
    response: Response,
    priority: Annotated[Priority, Query(description="interactive cases go before batch ones")] = "interactive",
    device: Annotated[Device, Query(description="kind of worker; gpu where the service has one")] = "cpu",
) -> SimulationResource:
    """Takes a case into the queue. ``deliver``, beside the specification, sends its files when it has succeeded."""
    require_deliver(caller, wanted)
    data = specification.model_dump(mode="json")
    queue = chosen_queue(served, priority, device)
    row = _made_before(served, making.identifier) if making.again else None
    if row is None:
        needs = _check(specification, served)
        served.store.require_room(needs.storage_bytes)
        name = specification.name.replace("\0", "")
        row = served.jobs.create(
            data,
            needs.model_dump(mode="json"),
            name,
            queue,
            identifier=making.identifier,
            submitter=submitter,
            deliver=wanted,
            retention=retention,
        )
        send(served, row)
    response.headers.update({"Location": str(request.base_url).rstrip("/") + simulation_path(row.id), **RETRY_AFTER})
    return simulation_resource(row, data)


@router.post("/estimate", openapi_extra=_BODY)
def estimate_needs(caller: Read, specification: PostedSpecification, served: Served) -> Estimate:
    """What a case would need; nothing is kept."""
    return _check(specification, served)


@router.get("")
def list_simulations(
    caller: Read,
    served: Served,
    request: Request,
    response: Response,
    state: Annotated[State | None, Query(description="only cases in this state")] = None,
    study_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$", description="only cases of this study")] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(description="from the page before; anything else: 400 bad-cursor")] = None,
) -> SimulationPage:
    """Cases, the newest first."""
    before = pages.decode(cursor) if cursor is not None else None
    rows = served.jobs.page(limit + 1, state, before, study_id)
    following = None
    if len(rows) > limit:
        last = rows[limit - 1]
        following = pages.encode((last.created, last.id))
        response.headers["Link"] = f'<{request.url.include_query_params(cursor=following)}>; rel="next"'
    return SimulationPage(items=[simulation_resource(row) for row in rows[:limit]], next=following)


@router.get("/{identifier}", response_model=SimulationResource, responses=UNCHANGED)
def get_simulation(caller: Read, identifier: Identifier, served: Served, if_none_match: IfNoneMatch = None) -> Response:
    """One case. Its entity tag is weak while it runs, and changes with its revision."""
    return _answer(served, served.jobs.get(identifier), if_none_match)


@router.post("/{identifier}/cancel", status_code=202)
def cancel(caller: Write, identifier: Identifier, served: Served, response: Response) -> SimulationResource:
    """Stops a case: at once where it is queued, within a second or so where it runs."""
    try:
        row = served.jobs.cancel(identifier)
    except StateError as error:
        raise ApiError(
            409, "already-finished", f"the simulation has {error.state}; there is nothing to cancel"
        ) from None
    if not row.is_final:
        response.headers.update(RETRY_AFTER)
    return simulation_resource(row)


@router.post("/{identifier}/retry", status_code=202)
def retry(
    caller: Write, identifier: Identifier, served: Served, request: Request, response: Response
) -> SimulationResource:
    """Queues a failed or cancelled case again; stages that finished are not computed again."""
    try:
        row = served.jobs.retry(identifier)
    except StateError as error:
        code = "already-finished" if error.state == "succeeded" else "not-finished"
        raise ApiError(
            409, code, f"the simulation is {error.state}; only a failed or cancelled one is retried"
        ) from None
    send(served, row)
    response.headers.update({"Location": str(request.base_url).rstrip("/") + simulation_path(row.id), **RETRY_AFTER})
    return simulation_resource(row)


@router.delete("/{identifier}", status_code=204, responses=CHANGED)
def delete(caller: Write, identifier: Identifier, served: Served, if_match: IfMatch = None) -> None:
    """Forgets a finished case. Stored stages stay: other cases may use them."""
    row = served.jobs.get(identifier)
    if row.study_id is not None:
        raise ApiError(409, "part-of-study", f"the simulation is a case of the study {row.study_id}: delete the study")
    if if_match is not None:
        require_match(if_match, _answer(served, row).headers["ETag"])
    try:
        served.jobs.delete(identifier)
    except StateError as error:
        raise ApiError(
            409, "not-finished", f"the simulation is {error.state}: cancel it first, or wait for its end"
        ) from None


def _answer(served: Services, row: Simulation, if_none_match: str | None = None) -> Response:
    content = simulation_resource(row, served.jobs.specification(row.id))
    if row.is_final:
        return document(content, if_none_match)
    # The seconds that are left change by themselves, and are no reason to send it again.
    headers = {"ETag": f'W/"{row.revision}{"-pinned" * row.pinned}"', "Cache-Control": "no-cache", **RETRY_AFTER}
    if none_match(if_none_match, headers["ETag"].removeprefix("W/").strip('"')):
        return Response(status_code=304, headers=headers)
    return JSONResponse(content.model_dump(mode="json"), headers=headers)


def chosen_queue(served: Services, priority: Priority, device: Device) -> Queue:
    """raises: ApiError 422 where there is no such worker"""
    if device == "gpu" and not served.settings.gpu:
        item = {"parameter": "device", "value": device, "detail": "allowed here: cpu"}
        raise ApiError(422, "invalid-request", "device = 'gpu': there is no worker with one; use cpu", errors=[item])
    return queue_of(priority, device)


def _check(specification: SimulationSpec, served: Services) -> Estimate:
    if isinstance(specification.phantom, UploadedPhantom):
        registry.require(served.store, specification.phantom)
    return estimate.check(specification, served.settings.memory_limit)


def _made_before(served: Services, identifier: str) -> Simulation | None:
    try:
        return served.jobs.get(identifier)
    except NotFoundError:
        return None


def send(served: Services, row: Simulation) -> None:
    """Sends the message of a row that is committed; where that fails the sweep sends it later."""
    try:
        served.messenger.send(row.id, row.queue)
        served.jobs.mark_sent(row.id)
    except Exception:
        log.exception("message not sent; the sweep will send it", extra={"simulation": row.id})
