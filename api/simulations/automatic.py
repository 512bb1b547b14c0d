"""``deliver``, a field beside a posted specification: where the files of the case go when it has succeeded."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import Depends, Request
from pydantic import BaseModel, ConfigDict, Field

from api.destinations.service import find_destination
from api.http.auth import Principal
from api.http.bodies import PostedCaseBody, body_named, parsed
from api.http.deps import services
from api.http.errors import ApiError

Json = dict[str, Any]


class WantedDelivery(BaseModel):
    """A delivery that begins with the success of the case."""

    model_config = ConfigDict(extra="forbid", strict=True)

    destination: str = Field(min_length=1, max_length=64, description="identifier or name of a destination")
    files: list[str] = Field([], max_length=100, description="names or patterns of files (projections/*); empty: all")


class _Wanted(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    deliver: list[WantedDelivery] = Field(max_length=10)


def _wanted(request: Request, case: PostedCaseBody) -> list[Json]:
    """What is to be delivered, with the identifiers of the destinations. raises: ApiError 422"""
    if case.deliver is None:
        return []
    entries = parsed(json.dumps({"deliver": case.deliver}).encode(), _Wanted).deliver
    rows = [
        find_destination(services(request), entry.destination, f"/deliver/{number}/destination")
        for number, entry in enumerate(entries)
    ]
    return [
        {"destination": row.id, "name": row.definition.name, "files": entry.files}
        for row, entry in zip(rows, entries, strict=True)
    ]


WantedDeliveries = Annotated[list[Json], Depends(_wanted)]


def require_deliver(caller: Principal, deliveries: list[Json]) -> None:
    """raises: ApiError 403 where something is to be delivered and the key does not allow that"""
    if deliveries and not caller.may("deliver"):
        raise ApiError(403, "scope-missing", "'deliver' needs a key with the scope 'deliver'")


BODY_WITH_DELIVER = body_named("PostedSimulation")
STUDY_WITH_DELIVER = body_named("PostedStudy")


def with_deliver(title: str, specification: Json) -> Json:
    """JSON Schema of what is posted: that of the specification, and ``deliver``."""
    deliver = {
        "type": "array",
        "maxItems": 10,
        "items": WantedDelivery.model_json_schema(),
        "description": "where the files go when the case has succeeded; no part of the specification",
    }
    return {
        **specification,
        "title": title,
        "properties": {**specification["properties"], "deliver": deliver},
    }
