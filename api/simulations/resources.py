"""What clients see: the documents of the API."""

from __future__ import annotations

import time
from datetime import datetime
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field

from api.http.documents import PREFIX, FailureResource, when, when_or_none
from simcore.estimate import Estimate
from worker.contract import Queue, State

if TYPE_CHECKING:  # clients import this file; they need no database
    from worker.records.jobs import Simulation


class ProgressResource(BaseModel):
    """Where a case stands."""

    stage: str | None = Field(description="the stage that is computed, or was last")
    stages_done: int
    stages_total: int
    fraction: float = Field(description="of the current stage, 0 to 1")
    message: str
    seconds_left: float | None = Field(description="a guess from the estimate, while it runs [s]")


class StudyPlace(BaseModel):
    """The place of a case in its study."""

    id: str
    number: int
    coordinates: dict[str, Any]


class SimulationResource(BaseModel):
    """One case."""

    id: str
    name: str
    state: State
    revision: int = Field(description="raised with every change")
    attempt: int
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    progress: ProgressResource
    estimate: Estimate
    queue: Queue = Field(description="interactive goes before batch")
    submitted_by: str | None = Field(description="the API key that posted it; local: none was needed")
    request_id: str | None = Field(description="of the request that posted it; log lines of the case carry it")
    error: FailureResource | None
    results: dict[str, Any] | None = Field(description="main numbers of a case that succeeded")
    expires_at: datetime | None = Field(description="its files are kept until then, or as long as it is pinned")
    pinned: bool
    study: StudyPlace | None = Field(None, description="of a case of a study")
    specification: dict[str, Any] | None = Field(None, description="left out of lists")
    links: dict[str, str]


class SimulationPage(BaseModel):
    """Some cases, the newest first; the next page is in the Link header and in ``next``."""

    items: list[SimulationResource]
    next: str | None


class ArtifactResource(BaseModel):
    """One file of a case that succeeded."""

    name: str
    size: int = Field(description="[byte]")
    sha256: str
    media_type: str
    stage: str | None = Field(description="the stage that made it")
    href: str


class ArtifactList(BaseModel):
    """All files of a case that succeeded."""

    items: list[ArtifactResource]
    links: dict[str, str]


def simulation_path(identifier: str) -> str:
    return f"{PREFIX}/simulations/{identifier}"


def simulation_resource(row: Simulation, specification: dict[str, Any] | None = None) -> SimulationResource:
    """The document of a case."""
    path = simulation_path(row.id)
    links = {"self": path, "events": f"{path}/events"}
    if row.study_id is not None:
        links["study"] = f"{PREFIX}/studies/{row.study_id}"
    if row.state == "succeeded":
        links |= {name: f"{path}/{name}" for name in ("artifacts", "archive", "manifest")}
    elif row.is_final:
        links["retry"] = f"{path}/retry"
    else:
        links["cancel"] = f"{path}/cancel"
    return SimulationResource(
        id=row.id,
        name=row.name,
        state=row.state,
        revision=row.revision,
        attempt=row.attempt,
        created_at=when(row.created),
        started_at=when_or_none(row.started),
        finished_at=when_or_none(row.finished),
        progress=_progress(row),
        estimate=Estimate(**row.estimate),
        queue=row.queue,
        submitted_by=row.submitted_by,
        request_id=row.request_id,
        error=FailureResource(**row.error) if row.error else None,
        results=row.results,
        expires_at=when_or_none(row.expires_at),
        pinned=row.pinned,
        study=_place(row),
        specification=specification,
        links=links,
    )


def _place(row: Simulation) -> StudyPlace | None:
    if row.study_id is None:
        return None
    return StudyPlace(id=row.study_id, number=row.study_number or 0, coordinates=row.coordinates or {})


def _progress(row: Simulation) -> ProgressResource:
    left = None
    if row.state == "running" and row.started is not None:
        left = round(max(0.0, row.estimate["seconds"] - (time.time() - row.started)), 1)
    return ProgressResource(
        stage=row.stage,
        stages_done=row.stages_done,
        stages_total=row.stages_total,
        fraction=row.fraction,
        message=row.message,
        seconds_left=left,
    )
