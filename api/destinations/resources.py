"""Documents of destinations, made from their rows."""

from __future__ import annotations

from api.http.documents import PREFIX, when
from tomosim_contract.destination import Destination
from tomosim_contract.destinations import DestinationResource
from worker.records.destinations import DestinationRow


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
