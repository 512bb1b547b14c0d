"""/v1/studies: post, look, cancel, retry, forget."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, BackgroundTasks, Depends, Query, Request, Response

from api.http.auth import Read, Submitting, Write
from api.http.bodies import PostedCaseBody, body_named
from api.http.conditions import CHANGED, UNCHANGED, IfMatch, IfNoneMatch, document, require_match
from api.http.deps import RETRY_AFTER, Served, Services, StudyIdentifier, location
from api.http.errors import ApiError
from api.http.idempotency import IdempotentRoute, Making
from api.http.pages import AskedPage
from api.simulations.automatic import STUDY_WITH_DELIVER, WantedDeliveries, require_deliver
from api.simulations.retention import AskedRetention
from api.simulations.service import chosen_queue
from api.studies import results
from api.studies.resources import study_path, study_resource
from api.studies.service import check
from simcore.study import StudySpec
from simcore.study.expansion import columns
from tomosim_contract.names import Device, Priority, State
from tomosim_contract.studies import StudyEstimate, StudyPage, StudyResource
from worker.records.studies import Study

SENT_AT_ONCE = 10
"""Messages that follow the answer to a new study; the sweep sends the others, so that no request waits for them."""

router = APIRouter(prefix="/studies", tags=["studies"], route_class=IdempotentRoute)


def _posted_study(case: PostedCaseBody) -> StudySpec:
    """raises: ApiError 413, 415; SpecError naming every wrong field"""
    return StudySpec.parse(case.specification)


PostedStudy = Annotated[StudySpec, Depends(_posted_study)]


@router.post("", status_code=202, openapi_extra=STUDY_WITH_DELIVER)
def create(
    caller: Write,
    submitter: Submitting,
    study: PostedStudy,
    deliveries: WantedDeliveries,
    served: Served,
    making: Making,
    retention: AskedRetention,
    request: Request,
    response: Response,
    background: BackgroundTasks,
    priority: Annotated[Priority, Query(description="interactive cases go before batch ones")] = "batch",
    device: Annotated[Device, Query(description="kind of worker; gpu where the service has one")] = "cpu",
) -> StudyResource:
    """Takes a study: all its cases are validated and queued, or none.

    ``deliver``, beside the study, sends the files of each case when that has succeeded.
    """
    require_deliver(caller, deliveries)
    queue = chosen_queue(served, priority, device)
    row = making.earlier(served.studies.get)
    if row is None:
        checked = check(study, served)
        served.store.require_room(checked.needs.storage_bytes)
        document = study.model_dump(mode="json")
        row = served.studies.create(
            study.name,
            document,
            columns(study),
            checked.needs.model_dump(),
            checked.cases,
            making.identifier,
            queue,
            submitter,
            retention,
            deliveries,
        )
    background.add_task(_send_first, served, row.id)
    response.headers.update({**location(request, study_path(row.id)), **RETRY_AFTER})
    return study_resource(row, served.studies.document(row.id))


@router.post("/estimate", openapi_extra=body_named("StudySpec"))
def estimate_needs(caller: Read, study: PostedStudy, served: Served) -> StudyEstimate:
    """What a study would need; nothing is kept."""
    return check(study, served).needs


@router.get("")
def list_studies(
    caller: Read,
    served: Served,
    page: AskedPage,
) -> StudyPage:
    """Studies, the newest first."""
    rows = served.studies.page(page.rows, page.before)
    shown, following = page.shown(rows)
    return StudyPage(items=[study_resource(row) for row in shown], next=following)


@router.get("/{identifier}", response_model=StudyResource, responses=UNCHANGED)
def get_study(caller: Read, identifier: StudyIdentifier, served: Served, if_none_match: IfNoneMatch = None) -> Response:
    """One study. Its entity tag changes with its counts."""
    return _answer(served, served.studies.get(identifier), if_none_match)


@router.post("/{identifier}/cancel", status_code=202)
def cancel(caller: Write, identifier: StudyIdentifier, served: Served, response: Response) -> StudyResource:
    """Stops all cases that have not finished."""
    row, number = served.studies.cancel(identifier)
    if number == 0 and row.is_final and row.state != "cancelled":
        raise ApiError(409, "already-finished", f"the study has ended ({row.state}); there is nothing to cancel")
    if not row.is_final:
        response.headers.update(RETRY_AFTER)
    return study_resource(row)


@router.post("/{identifier}/retry", status_code=202)
def retry(
    caller: Write,
    identifier: StudyIdentifier,
    served: Served,
    request: Request,
    response: Response,
    background: BackgroundTasks,
    cancelled: Annotated[bool, Query(description="cancelled cases as well")] = False,
) -> StudyResource:
    """Queues the failed cases again; stages that finished are not computed again."""
    states: list[State] = ["failed", "cancelled"] if cancelled else ["failed"]
    row, number = served.studies.retry(identifier, states)
    if number == 0:
        raise ApiError(409, "nothing-to-retry", f"no case of the study is {' or '.join(states)}; it is {row.state}")
    background.add_task(_send_first, served, row.id)
    response.headers.update({**location(request, study_path(row.id)), **RETRY_AFTER})
    return study_resource(row)


@router.delete("/{identifier}", status_code=204, responses=CHANGED)
def delete(caller: Write, identifier: StudyIdentifier, served: Served, if_match: IfMatch = None) -> None:
    """Forgets a study that has ended, and its cases. Stored stages stay: other cases may use them."""
    if if_match is not None:
        require_match(if_match, _answer(served, served.studies.get(identifier)).headers["ETag"])
    if not served.studies.delete(identifier):
        state = served.studies.get(identifier).state
        raise ApiError(409, "not-finished", f"the study is {state}: cancel it first, or wait for its end")


router.include_router(results.router)


def _answer(served: Services, row: Study, if_none_match: str | None = None) -> Response:
    content = study_resource(row, served.studies.document(row.id))
    return document(content, if_none_match, {} if row.is_final else RETRY_AFTER)


def _send_first(served: Services, identifier: str) -> None:
    for case in served.studies.unsent(identifier, SENT_AT_ONCE):
        served.send(served.jobs, case)
