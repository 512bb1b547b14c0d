"""/v1/deliveries: cases on their way to a destination."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import StreamingResponse

from api.deliveries.resources import delivery_path, delivery_resource, instance_resource
from api.deliveries.service import items_of_case, items_of_study
from api.destinations.service import find_destination
from api.http import streams
from api.http.auth import Deliver, Read
from api.http.bodies import body_of, posted
from api.http.conditions import none_match
from api.http.deps import RETRY_AFTER, Served, identifier_of, location
from api.http.idempotency import IdempotentRoute, Making
from api.http.pages import AskedPage
from tomosim_contract.deliveries import DeliveryPage, DeliveryResource, InstancePage, NewDelivery
from tomosim_contract.names import InstanceState, State
from worker.records.delivery_tables import Request as DeliveryRequest

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
    row = making.earlier(served.deliveries.get)
    if row is None:
        destination = find_destination(served, new.destination, "/destination")
        items = items_of_study(served, new) if new.study_id else items_of_case(served, new)
        delivery = DeliveryRequest(destination.id, items, simulation_id=new.simulation_id, study_id=new.study_id)
        row = served.deliveries.create(delivery, making.identifier)
        served.send(served.deliveries, row)
    response.headers.update({**location(request, delivery_path(row.id)), **RETRY_AFTER})
    return delivery_resource(row, served.deliveries.instances(row.id, limit=SHOWN_INSTANCES))


@router.get("")
def list_deliveries(
    caller: Read,
    served: Served,
    page: AskedPage,
    state: Annotated[State | None, Query(description="only deliveries in this state")] = None,
    simulation_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$")] = None,
    study_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$")] = None,
    destination_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$")] = None,
) -> DeliveryPage:
    """Deliveries, the newest first."""
    rows = served.deliveries.page(
        page.rows,
        page.before,
        state=state,
        simulation_id=simulation_id,
        study_id=study_id,
        destination_id=destination_id,
    )
    shown, following = page.shown(rows)
    return DeliveryPage(items=[delivery_resource(row) for row in shown], next=following)


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


@router.get("/{identifier}/events", response_class=StreamingResponse, responses=streams.RESUMED_STREAM)
def events(
    caller: Read, identifier: Identifier, served: Served, last_event_id: streams.LastEventId = None
) -> StreamingResponse:
    """Events ``state`` and ``progress`` (each instance, bytes) from the first, or after Last-Event-ID, to the end."""
    served.deliveries.get(identifier)
    sequence = streams.sequence_of(last_event_id)
    return streams.answer(streams.stream(served.deliveries, identifier, sequence, delivery_path(identifier)))


@router.post("/{identifier}/cancel", status_code=202)
def cancel(caller: Deliver, identifier: Identifier, served: Served, response: Response) -> DeliveryResource:
    """Stops a delivery: at once where it is queued, within a second or so where it runs. What is stored stays."""
    row = served.cancel(served.deliveries, identifier)
    if not row.is_final:
        response.headers.update(RETRY_AFTER)
    return delivery_resource(row)


@router.post("/{identifier}/retry", status_code=202)
def retry(
    caller: Deliver, identifier: Identifier, served: Served, request: Request, response: Response
) -> DeliveryResource:
    """Queues a failed or cancelled delivery again; what was stored is not sent again."""
    row = served.retry(served.deliveries, identifier)
    response.headers.update({**location(request, delivery_path(row.id)), **RETRY_AFTER})
    return delivery_resource(row)
