"""/v1/simulations: post, look, cancel, retry, forget."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse, StreamingResponse

from api.http import streams
from api.http.auth import Read, Submitting, Write
from api.http.bodies import PostedSpecification, body_named
from api.http.conditions import CHANGED, UNCHANGED, IfMatch, IfNoneMatch, document, none_match, require_match
from api.http.deps import RETRY_AFTER, Identifier, Served, Services, location
from api.http.errors import ApiError
from api.http.idempotency import IdempotentRoute, Making
from api.http.pages import AskedPage
from api.simulations.automatic import BODY_WITH_DELIVER, WantedDeliveries, require_deliver
from api.simulations.resources import simulation_path, simulation_resource
from api.simulations.retention import AskedRetention
from api.simulations.service import check, chosen_queue
from simcore.needs import Estimate
from tomosim_contract.names import Device, Priority, State
from tomosim_contract.simulations import SimulationPage, SimulationResource
from worker.records.jobs import Simulation
from worker.records.rows import StateError

router = APIRouter(prefix="/simulations", tags=["simulations"], route_class=IdempotentRoute)


@router.post("", status_code=202, openapi_extra=BODY_WITH_DELIVER)
def create(
    caller: Write,
    submitter: Submitting,
    specification: PostedSpecification,
    deliveries: WantedDeliveries,
    served: Served,
    making: Making,
    retention: AskedRetention,
    request: Request,
    response: Response,
    priority: Annotated[Priority, Query(description="interactive cases go before batch ones")] = "interactive",
    device: Annotated[Device, Query(description="kind of worker; gpu where the service has one")] = "cpu",
) -> SimulationResource:
    """Takes a case into the queue. ``deliver``, beside the specification, sends its files when it has succeeded."""
    require_deliver(caller, deliveries)
    data = specification.model_dump(mode="json")
    queue = chosen_queue(served, priority, device)
    row = making.earlier(served.jobs.get)
    if row is None:
        needs = check(specification, served)
        served.store.require_room(needs.storage_bytes)
        name = specification.name.replace("\0", "")
        row = served.jobs.create(
            data,
            needs.model_dump(mode="json"),
            name,
            queue,
            identifier=making.identifier,
            submitter=submitter,
            deliver=deliveries,
            retention=retention,
        )
        served.send(served.jobs, row)
    response.headers.update({**location(request, simulation_path(row.id)), **RETRY_AFTER})
    return simulation_resource(row, data)


@router.post("/estimate", openapi_extra=body_named("SimulationSpec"))
def estimate_needs(caller: Read, specification: PostedSpecification, served: Served) -> Estimate:
    """What a case would need; nothing is kept."""
    return check(specification, served)


@router.get("")
def list_simulations(
    caller: Read,
    served: Served,
    page: AskedPage,
    state: Annotated[State | None, Query(description="only cases in this state")] = None,
    study_id: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$", description="only cases of this study")] = None,
) -> SimulationPage:
    """Cases, the newest first."""
    rows = served.jobs.page(page.rows, state, page.before, study_id)
    shown, following = page.shown(rows)
    return SimulationPage(items=[simulation_resource(row) for row in shown], next=following)


@router.get("/{identifier}", response_model=SimulationResource, responses=UNCHANGED)
def get_simulation(caller: Read, identifier: Identifier, served: Served, if_none_match: IfNoneMatch = None) -> Response:
    """One case. Its entity tag is weak while it runs, and changes with its revision."""
    return _answer(served, served.jobs.get(identifier), if_none_match)


@router.post("/{identifier}/cancel", status_code=202)
def cancel(caller: Write, identifier: Identifier, served: Served, response: Response) -> SimulationResource:
    """Stops a case: at once where it is queued, within a second or so where it runs."""
    row = served.cancel(served.jobs, identifier)
    if not row.is_final:
        response.headers.update(RETRY_AFTER)
    return simulation_resource(row)


@router.post("/{identifier}/retry", status_code=202)
def retry(
    caller: Write, identifier: Identifier, served: Served, request: Request, response: Response
) -> SimulationResource:
    """Queues a failed or cancelled case again; stages that finished are not computed again."""
    row = served.retry(served.jobs, identifier)
    response.headers.update({**location(request, simulation_path(row.id)), **RETRY_AFTER})
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


@router.get("/{identifier}/events", response_class=StreamingResponse, responses=streams.RESUMED_STREAM)
def events(
    caller: Read, identifier: Identifier, served: Served, last_event_id: streams.LastEventId = None
) -> StreamingResponse:
    """Events ``state`` and ``progress`` from the first (or after Last-Event-ID) to the final state."""
    served.jobs.get(identifier)
    sequence = streams.sequence_of(last_event_id)
    return streams.answer(streams.stream(served.jobs, identifier, sequence, simulation_path(identifier)))


def _answer(served: Services, row: Simulation, if_none_match: str | None = None) -> Response:
    content = simulation_resource(row, served.jobs.specification(row.id))
    if row.is_final:
        return document(content, if_none_match)
    # The seconds that are left change by themselves, and are no reason to send it again.
    headers = {"ETag": f'W/"{row.revision}{"-pinned" * row.pinned}"', "Cache-Control": "no-cache", **RETRY_AFTER}
    if none_match(if_none_match, headers["ETag"].removeprefix("W/").strip('"')):
        return Response(status_code=304, headers=headers)
    return JSONResponse(content.model_dump(mode="json"), headers=headers)
