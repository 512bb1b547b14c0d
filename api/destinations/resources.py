"""What clients see of destinations. Imported by clients: no server, no database."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

from pydantic import BaseModel, Field

from api.http.documents import PREFIX, when
from worker.destination_spec import Destination

if TYPE_CHECKING:
    from worker.records.destinations import DestinationRow


class DestinationResource(Destination):
    """A destination."""

    id: str
    revision: int = Field(description="raised with every change")
    created_at: datetime
    links: dict[str, str]


class DestinationName(BaseModel):
    """What those may see who may deliver and are no administrators."""

    id: str
    name: str


class DestinationList(BaseModel):
    """All destinations, by name."""

    items: list[DestinationResource | DestinationName]


class EchoResource(BaseModel):
    """How a destination answered."""

    reachable: bool = Field(description="whether it accepted the association and answered C-ECHO")
    code: str = Field(description="'ok', or what went wrong: stable, machine-readable")
    message: str
    seconds: float
    accepted: list[str] = Field(description="SOP classes of ours that it accepts")
    refused: list[str] = Field(description="SOP classes of ours that it refuses: those series will not be stored")


def destination_path(identifier: str) -> str:
    return f"{PREFIX}/destinations/{identifier}"


def destination_resource(row: DestinationRow) -> DestinationResource:
    """The document of a destination."""
    path = destination_path(row.id)
    links = {"self": path, "echo": f"{path}/echo", "deliveries": f"{PREFIX}/deliveries?destination_id={row.id}"}
    return DestinationResource(
        **{name: getattr(row.definition, name) for name in Destination.model_fields},
        id=row.id,
        revision=row.revision,
        created_at=when(row.created),
        links=links,
    )
