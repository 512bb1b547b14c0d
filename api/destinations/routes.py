"""/v1/destinations: archives and workstations that cases can be sent to. Administrators alone."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import JSONResponse

from api.destinations.resources import destination_path, destination_resource
from api.destinations.service import check_host, merge, name_taken
from api.http.auth import Administer, Deliver
from api.http.bodies import body_of, content_type, parsed, posted, read_body
from api.http.conditions import CHANGED, UNCHANGED, IfMatch, IfNoneMatch, none_match, require_match
from api.http.deps import Served, identifier_of, location, services
from api.http.errors import ApiError
from api.http.idempotency import IdempotentRoute, Making
from tomosim_contract.destination import Destination
from tomosim_contract.destinations import DestinationList, DestinationName, DestinationResource, EchoResource
from worker.records.destinations import DestinationRow, InUseError, NameTakenError

MERGE_PATCH = "application/merge-patch+json"

router = APIRouter(prefix="/destinations", tags=["deliveries"], route_class=IdempotentRoute)


Identifier = Annotated[str, Depends(identifier_of("destination"))]


async def _new(request: Request) -> Destination:
    new = await posted(request, Destination)
    check_host(new, services(request))
    return new


async def _changes(request: Request) -> dict[str, Any]:
    kind = content_type(request)
    if kind not in (MERGE_PATCH, "application/json"):
        raise ApiError(415, "unsupported-media-type", f"Content-Type = {kind!r}: the body must be {MERGE_PATCH}")
    text = await read_body(request, services(request).settings.body_limit_bytes)
    try:
        document = json.loads(text)
    except ValueError as error:
        raise ApiError(422, "invalid-request", f"the body is not JSON: {error}") from None
    if not isinstance(document, dict):
        raise ApiError(422, "invalid-request", "the body must be an object with the fields that change")
    return document


@router.post("", status_code=201, openapi_extra=body_of(Destination))
def create(
    caller: Administer,
    new: Annotated[Destination, Depends(_new)],
    served: Served,
    making: Making,
    request: Request,
    response: Response,
) -> DestinationResource:
    """Makes a destination. Nothing is sent to it; ``echo`` tests it."""
    row = making.earlier(served.destinations.get)
    if row is None:
        try:
            row = served.destinations.create(new, making.identifier)
        except NameTakenError as error:
            raise name_taken(error) from None
    response.headers.update(location(request, destination_path(row.id)))
    return destination_resource(row)


@router.get("")
def list_destinations(caller: Deliver, served: Served) -> DestinationList:
    """All destinations; those who are no administrators see names and identifiers."""
    rows = served.destinations.all()
    if caller.may("admin"):
        return DestinationList(items=[destination_resource(row) for row in rows])
    return DestinationList(items=[DestinationName(id=row.id, name=row.definition.name) for row in rows])


@router.get("/{identifier}", response_model=DestinationResource, responses=UNCHANGED)
def get_destination(
    caller: Administer, identifier: Identifier, served: Served, if_none_match: IfNoneMatch = None
) -> Response:
    """One destination. Its entity tag is its revision."""
    row = served.destinations.get(identifier)
    headers = {"ETag": _tag(row), "Cache-Control": "no-cache"}
    if none_match(if_none_match, str(row.revision)):
        return Response(status_code=304, headers=headers)
    return JSONResponse(destination_resource(row).model_dump(mode="json"), headers=headers)


@router.patch(
    "/{identifier}",
    openapi_extra={"requestBody": {"required": True, "content": {MERGE_PATCH: {"schema": {"type": "object"}}}}},
    responses={
        409: {"description": "name-taken, or changed meanwhile"},
        **CHANGED,
    },
)
def change(
    caller: Administer,
    identifier: Identifier,
    changes: Annotated[dict[str, Any], Depends(_changes)],
    served: Served,
    response: Response,
    if_match: IfMatch = None,
) -> DestinationResource:
    """Changes fields (RFC 7396: null gives a field back its default). Deliveries under way keep the old ones."""
    row = served.destinations.get(identifier)
    require_match(if_match, _tag(row))
    merged = merge(row.definition.model_dump(mode="json"), changes)
    definition = parsed(json.dumps(merged).encode(), Destination)
    check_host(definition, served)
    try:
        changed = served.destinations.replace(identifier, definition, row.revision)
    except NameTakenError as error:
        raise name_taken(error) from None
    if changed is None:
        raise ApiError(409, "changed-meanwhile", "another change came first: read the destination again")
    response.headers["ETag"] = _tag(changed)
    return destination_resource(changed)


@router.delete("/{identifier}", status_code=204, responses=CHANGED)
def delete(caller: Administer, identifier: Identifier, served: Served, if_match: IfMatch = None) -> None:
    """Forgets a destination; deliveries that have ended stay on record."""
    row = served.destinations.get(identifier)
    require_match(if_match, _tag(row))
    try:
        done = served.destinations.delete(identifier, None if if_match is None else row.revision)
    except InUseError as error:
        detail = f"{error.count} deliveries to it have not ended: cancel them, or wait for their end"
        raise ApiError(409, "destination-in-use", detail) from None
    if not done:
        require_match(if_match, _tag(served.destinations.get(identifier)))


@router.post("/{identifier}/echo")
def echo(caller: Administer, identifier: Identifier, served: Served) -> EchoResource:
    """Opens an association, sends C-ECHO, and says which of our SOP classes it accepts.

    Many archives accept this from everybody and store only from AE titles they know.
    """
    from worker.delivery.echo import echo as send_echo

    answer = send_echo(served.destinations.get(identifier).definition, served.settings)
    return EchoResource(**answer)


def _tag(row: DestinationRow) -> str:
    return f'"{row.revision}"'
