"""Documents of destinations and deliveries, made from their rows."""

from __future__ import annotations

from api.destinations.resources import destination_path
from api.http.documents import PREFIX, when, when_or_none
from api.simulations.resources import simulation_path
from tomosim_contract.deliveries import DeliveryResource, InstanceResource
from tomosim_contract.failure import FailureResource
from worker.records.delivery_tables import Delivery, Instance


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
        started_at=when_or_none(row.started),
        finished_at=when_or_none(row.finished),
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
        finished_at=when_or_none(row.finished),
    )
