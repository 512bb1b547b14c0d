"""What clients see of destinations and deliveries. Imported by clients: no server, no database."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from api.destinations.resources import destination_path
from api.http.documents import PREFIX, FailureResource, when, when_or_none
from api.simulations.resources import simulation_path
from worker.contract import InstanceState, State

if TYPE_CHECKING:
    from worker.records.delivery_tables import Delivery, Instance


class NewDelivery(BaseModel):
    """What is to be sent, and where."""

    model_config = ConfigDict(extra="forbid", strict=True)

    destination: str = Field(min_length=1, max_length=64, description="identifier or name of a destination")
    simulation_id: str | None = Field(None, pattern="^[0-9a-f]{32}$", description="a case that succeeded")
    study_id: str | None = Field(
        None, pattern="^[0-9a-f]{32}$", description="a study: all its cases that have succeeded so far"
    )
    series: list[str] = Field([], max_length=100, description="Series Instance UIDs of a case; empty: every series")
    files: list[str] = Field(
        [], max_length=100, description="names or patterns of files (tomosynthesis.dcm, projections/*); empty: all"
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.simulation_id is None) == (self.study_id is None):
            raise ValueError("simulation_id, study_id: give one of them")
        if self.series and self.study_id is not None:
            raise ValueError("series: every case of a study has its own; choose by files")
        if self.series and self.files:
            raise ValueError("series and files: give one of them")
        return self


class InstanceResource(BaseModel):
    """One instance on its way."""

    number: int
    simulation_id: str
    name: str = Field(description="the file of the case")
    sha256: str
    size: int = Field(description="[byte]")
    sop_instance_uid: str | None = Field(description="null until it was read")
    state: InstanceState
    attempts: int
    status: str | None = Field(description="of the C-STORE response, hexadecimal; null where none came")
    code: str | None
    message: str
    finished_at: datetime | None


class InstancePage(BaseModel):
    """Some instances in order; the next ones: ``after`` = ``next``."""

    items: list[InstanceResource]
    next: int | None


class DeliveryResource(BaseModel):
    """One delivery. Counts of instances and bytes; what is neither stored nor failed waits."""

    id: str
    state: State
    revision: int = Field(description="raised with every change")
    destination: dict[str, str]
    simulation_id: str | None
    study_id: str | None
    automatic: bool = Field(description="made by the success of the case")
    attempt: int
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    next_attempt_at: datetime | None = Field(description="a queued delivery is not tried before")
    message: str
    error: FailureResource | None = Field(description="why it failed, or why the last attempt did")
    instances_total: int
    instances_stored: int
    instances_failed: int
    bytes_total: int
    bytes_stored: int
    instances: list[InstanceResource] | None = Field(None, description="left out of lists; the first 1000")
    links: dict[str, str]


class DeliveryPage(BaseModel):
    """Some deliveries, the newest first; the next page is in the Link header and in ``next``."""

    items: list[DeliveryResource]
    next: str | None


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
