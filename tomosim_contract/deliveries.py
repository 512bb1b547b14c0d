"""What a delivery is asked with, and answers about deliveries."""

from __future__ import annotations

from datetime import datetime
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tomosim_contract.failure import FailureResource
from tomosim_contract.names import InstanceState, State


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
