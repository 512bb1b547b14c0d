"""/v1/deliveries: cases on their way to a destination."""

from __future__ import annotations

import logging
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import StreamingResponse

from api import pages
from api.artifacts import finished_manifest
from api.auth import Deliver, Read
from api.bodies import body_of, posted
from api.conditions import none_match
from api.delivery_resources import DeliveryPage, DeliveryResource, InstancePage, InstanceResource, NewDelivery
from api.deps import Served, Services, identifier_of
from api.destinations import destination_path, find_destination
from api.errors import ApiError
from api.events import STREAM_HEADERS, sequence_of, stream
from api.idempotency import IdempotentRoute, Making
from api.resources import PREFIX, FailureResource, simulation_path, when
from api.simulations import RETRY_AFTER
from simcore.core.store import FileRef
from worker.contract import InstanceState, State
from worker.records.delivery_tables import Delivery, Instance, Item, items_of
from worker.records.delivery_tables import Request as DeliveryRequest
from worker.records.rows import NotFoundError, StateError

log = logging.getLogger(__name__)

CASES_AT_A_TIME = 200

SHOWN_INSTANCES = 1000
"""Instances in the document of one delivery; more are read page by page."""

router = APIRouter(prefix="/deliveries", tags=["deliveries"], route_class=IdempotentRoute)


Identifier = Annotated[str, Depends(identifier_of("delivery"))]


async def _new(request: Request) -> NewDelivery:
    return await posted(request, NewDelivery)


@router.post("", status_code=202, openapi_extra=body_of(NewDelivery))
def create(
    caller: Deliver,
    new: Annotated[NewDelivery, Depends(_new)],
    served: Served,
    making: Making,
    request: Request,
    response: Response,
) -> DeliveryResource:
    """Queues a delivery: a whole case or study, some series of a case, or some of the files."""
    row = _made_before(served, making.identifier) if making.again else None
    if row is None:
        destination = find_destination(served, new.destination, "/destination")
        items = _of_study(served, new) if new.study_id else _of_case(served, new)
        wanted = DeliveryRequest(destination.id, items, simulation_id=new.simulation_id, study_id=new.study_id)
        row = served.deliveries.create(wanted, making.identifier)
        _send(served, row)
    response.headers.update({"Location": str(request.base_url).rstrip("/") + delivery_path(row.id), **RETRY_AFTER})
    return delivery_resource(row, served.deliveries.instances(row.id, limit=SHOWN_INSTANCES))


@router.get("")
def list_deliveries(
    caller: Read,
    served: Served,
    request: Request,
    response: Response,
    state: Annotated[State | None, Query(description="only deliveries in this state")] = None,
    simulation_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$")] = None,
    study_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$")] = None,
    destination_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$")] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(description="from the page before; anything else: 400 bad-cursor")] = None,
) -> DeliveryPage:
    """Deliveries, the newest first."""
    before = pages.decode(cursor) if cursor is not None else None
    rows = served.deliveries.page(
        limit + 1, before, state=state, simulation_id=simulation_id, study_id=study_id, destination_id=destination_id
    )
    following = None
    if len(rows) > limit:
        last = rows[limit - 1]
        following = pages.encode((last.created, last.id))
        response.headers["Link"] = f'<{request.url.include_query_params(cursor=following)}>; rel="next"'
    return DeliveryPage(items=[delivery_resource(row) for row in rows[:limit]], next=following)


@router.get("/{identifier}", responses={304: {"description": "not changed"}})
def get_delivery(
    caller: Read,
    identifier: Identifier,
    served: Served,
    response: Response,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Any:
    """One delivery with its instances. Its entity tag changes with its revision."""
    row = served.deliveries.get(identifier)
    headers = {"ETag": f'W/"{row.revision}"', "Cache-Control": "no-cache"}
    if not row.is_final:
        headers |= RETRY_AFTER
    if none_match(if_none_match, str(row.revision)):
        return Response(status_code=304, headers=headers)
    response.headers.update(headers)
    return delivery_resource(row, served.deliveries.instances(identifier, limit=SHOWN_INSTANCES))


@router.get("/{identifier}/instances")
def list_instances(
    caller: Read,
    identifier: Identifier,
    served: Served,
    state: Annotated[InstanceState | None, Query(description="only instances in this state")] = None,
    after: Annotated[int, Query(ge=-1, le=2**31 - 1, description="number of the last one already seen")] = -1,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
) -> InstancePage:
    """The instances of a delivery, in order."""
    served.deliveries.get(identifier)
    rows = served.deliveries.instances(identifier, state=state, after=after, limit=limit + 1)
    following = rows[limit - 1].number if len(rows) > limit else None
    return InstancePage(items=[instance_resource(row) for row in rows[:limit]], next=following)


@router.get(
    "/{identifier}/events",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {}}}, 400: {"description": "bad-event-id"}},
)
def events(
    caller: Read,
    identifier: Identifier,
    served: Served,
    last_event_id: Annotated[str | None, Header(description="the last event seen; a number")] = None,
) -> StreamingResponse:
    """Events ``state`` and ``progress`` (each instance, bytes) from the first, or after Last-Event-ID, to the end."""
    served.deliveries.get(identifier)
    found = stream(served.deliveries, identifier, sequence_of(last_event_id), delivery_path(identifier))
    return StreamingResponse(found, media_type="text/event-stream", headers=STREAM_HEADERS)


@router.post("/{identifier}/cancel", status_code=202)
def cancel(caller: Deliver, identifier: Identifier, served: Served, response: Response) -> DeliveryResource:
    """Stops a delivery: at once where it is queued, within a second or so where it runs. What is stored stays."""
    try:
        row = served.deliveries.cancel(identifier)
    except StateError as error:
        detail = f"the delivery has {error.state}; there is nothing to cancel"
        raise ApiError(409, "already-finished", detail) from None
    if not row.is_final:
        response.headers.update(RETRY_AFTER)
    return delivery_resource(row)


@router.post("/{identifier}/retry", status_code=202)
def retry(
    caller: Deliver, identifier: Identifier, served: Served, request: Request, response: Response
) -> DeliveryResource:
    """Queues a failed or cancelled delivery again; what was stored is not sent again."""
    try:
        row = served.deliveries.retry(identifier)
    except StateError as error:
        code = "already-finished" if error.state == "succeeded" else "not-finished"
        detail = f"the delivery is {error.state}; only a failed or cancelled one is retried"
        raise ApiError(409, code, detail) from None
    _send(served, row)
    response.headers.update({"Location": str(request.base_url).rstrip("/") + delivery_path(row.id), **RETRY_AFTER})
    return delivery_resource(row)


def delivery_path(identifier: str) -> str:
    return f"{PREFIX}/deliveries/{identifier}"


def delivery_resource(row: Delivery, instances: list[Instance] | None = None) -> DeliveryResource:
    """The document of a delivery."""
    path = delivery_path(row.id)
    links = {"self": path, "events": f"{path}/events", "instances": f"{path}/instances"}
    links["destination"] = destination_path(row.destination_id)
    if row.simulation_id:
        links["simulation"] = simulation_path(row.simulation_id)
    if not row.is_final:
        links["cancel"] = f"{path}/cancel"
    elif row.state != "succeeded":
        links["retry"] = f"{path}/retry"
    return DeliveryResource(
        id=row.id,
        state=row.state,
        revision=row.revision,
        destination={"id": row.destination_id, "name": row.destination_name},
        simulation_id=row.simulation_id,
        study_id=row.study_id,
        automatic=row.automatic,
        attempt=row.attempt,
        created_at=when(row.created),
        started_at=when(row.started) if row.started else None,
        finished_at=when(row.finished) if row.finished else None,
        next_attempt_at=when(row.not_before) if row.not_before and row.state == "queued" else None,
        message=row.message,
        error=FailureResource(**row.error) if row.error else None,
        instances_total=row.instances,
        instances_stored=row.instances_stored,
        instances_failed=row.instances_failed,
        bytes_total=row.bytes,
        bytes_stored=row.bytes_stored,
        instances=None if instances is None else [instance_resource(i) for i in instances],
        links=links,
    )


def instance_resource(row: Instance) -> InstanceResource:
    """The document of an instance."""
    return InstanceResource(
        number=row.number,
        simulation_id=row.simulation_id,
        name=row.name,
        sha256=row.sha256,
        size=row.size,
        sop_instance_uid=row.sop_instance,
        state=row.state,
        attempts=row.attempts,
        status=None if row.status is None else f"0x{row.status:04X}",
        code=row.code,
        message=row.message,
        finished_at=when(row.finished) if row.finished else None,
    )


def _made_before(served: Services, identifier: str) -> Delivery | None:
    try:
        return served.deliveries.get(identifier)
    except NotFoundError:
        return None


def _of_study(served: Services, new: NewDelivery) -> list[Item]:
    """The files of all cases that have succeeded. raises: NotFoundError; ApiError 409, 422 where there are none"""
    assert new.study_id is not None
    served.studies.get(new.study_id)
    items: list[Item] = []
    before = None
    while rows := served.jobs.page(CASES_AT_A_TIME, "succeeded", before, new.study_id):
        before = (rows[-1].created, rows[-1].id)
        for row in rows:
            items += items_of(row.id, served.jobs.manifest(row.id) or {}, new.files)
    if not items:
        raise ApiError(409, "not-finished", "no case of the study has succeeded with a file that was asked for")
    return items


def _of_case(served: Services, new: NewDelivery) -> list[Item]:
    """What a body asks of a case. raises: ApiError 409 not-finished, 410 expired, 422 where it names nothing"""
    assert new.simulation_id is not None
    manifest = finished_manifest(served, new.simulation_id)
    items = items_of(new.simulation_id, manifest, new.files)
    for item in items:
        if not served.store.has(FileRef(item.sha256, item.size)):
            raise ApiError(410, "expired", f"{item.name} is not in the store any more: post the case again")
    if new.series:
        items = _of_series(served, items, new.series)
    if not items:
        names = ", ".join(item.name for item in items_of(new.simulation_id, manifest)) or "no DICOM file"
        detail = f"nothing of the case matches; it has: {names}"
        error = {"pointer": "/series" if new.series else "/files", "value": None, "detail": detail}
        raise ApiError(422, "invalid-request", detail, errors=[error])
    return items


def _of_series(served: Services, items: list[Item], series: list[str]) -> list[Item]:
    """Those of the items that belong to these series. raises: ApiError 422 naming a series that is not there"""
    from worker.delivery.files import read_series

    found = {item.name: read_series(served.store.path(FileRef(item.sha256, item.size))) for item in items}
    for wanted in series:
        if wanted not in found.values():
            known = ", ".join(sorted(set(filter(None, found.values()))))
            detail = f"the case has no series {wanted[:80]!r}; it has: {known}"
            error = {"pointer": f"/series/{series.index(wanted)}", "value": wanted[:80], "detail": detail}
            raise ApiError(422, "invalid-request", detail, errors=[error])
    return [item for item in items if found[item.name] in series]


def _send(served: Services, row: Delivery) -> None:
    """Sends the message of a row that is committed; where that fails, or it is not due, the sweep sends it later."""
    try:
        served.messenger.send(row.id, row.queue)
        served.deliveries.mark_sent(row.id)
    except Exception:
        log.exception("message not sent; the sweep will send it", extra={"delivery": row.id})
