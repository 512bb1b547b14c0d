"""What clients see of studies. Imported by clients: no server, no database."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field

from api.http.documents import PREFIX, FailureResource, when, when_or_none
from api.simulations.resources import simulation_path
from worker.contract import STATES, State, StudyState

if TYPE_CHECKING:
    from worker.records.jobs import Simulation
    from worker.records.studies import Study


class StudyEstimate(BaseModel):
    """Needs of a study of which nothing is in the store yet. Stages that cases share are computed once, so it may take
    much less time."""

    cases: int
    memory_bytes: int = Field(description="of the largest case [byte]")
    storage_bytes: int = Field(description="room in the store, at least [byte]")
    output_bytes: int = Field(description="size of the files of all cases [byte]")
    seconds: float = Field(description="of all cases one after the other, nothing shared [s]")


class StudyResource(BaseModel):
    """One study."""

    id: str
    name: str
    state: StudyState = Field(
        description="of all cases together; partial: all have ended, some succeeded and some did not"
    )
    cases: int
    counts: dict[State, int] = Field(description="cases by state")
    finished_cases: int
    columns: list[str] = Field(description="of the coordinates of the cases")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    estimate: StudyEstimate
    study: dict[str, Any] | None = Field(None, description="as it was posted, with its defaults; left out of lists")
    links: dict[str, str]


class StudyPage(BaseModel):
    """Some studies, the newest first; the next page is in the Link header and in ``next``."""

    items: list[StudyResource]
    next: str | None


class CaseResource(BaseModel):
    """One case of a study, in short."""

    number: int
    id: str
    name: str
    folder: str = Field(description="where its files lie in archives and downloads of the study")
    state: State
    coordinates: dict[str, Any] = Field(description="value or label on every axis")
    attempt: int
    started_at: datetime | None
    finished_at: datetime | None
    results: dict[str, Any] | None
    error: FailureResource | None
    expires_at: datetime | None = Field(description="its files are kept until then, or as long as it is pinned")
    expired: bool = Field(description="its files were kept until a time that has passed, and are not given out")
    href: str


class CasePage(BaseModel):
    """Some cases in the order of their numbers; the next page is in the Link header and in ``next``."""

    items: list[CaseResource]
    next: str | None


def study_path(identifier: str) -> str:
    return f"{PREFIX}/studies/{identifier}"


def folder_name(number: int) -> str:
    """The folder of a case in archives and downloads."""
    return f"case-{number:04d}"


def study_resource(row: Study, document: dict[str, Any] | None = None) -> StudyResource:
    """The document of a study."""
    path = study_path(row.id)
    links = {
        "self": path,
        "cases": f"{path}/cases",
        "simulations": f"{PREFIX}/simulations?study_id={row.id}",
        "manifest": f"{path}/manifest",
        "events": f"{path}/events",
    }
    if row.counts.get("succeeded"):
        links["archive"] = f"{path}/archive"
    if row.counts.get("failed"):
        links["retry"] = f"{path}/retry"
    if not row.is_final:
        links["cancel"] = f"{path}/cancel"
    return StudyResource(
        id=row.id,
        name=row.name,
        state=row.state,
        cases=row.cases,
        counts={state: row.counts.get(state, 0) for state in STATES},
        finished_cases=row.finished_cases,
        columns=row.columns,
        created_at=when(row.created),
        started_at=when_or_none(row.started),
        finished_at=when_or_none(row.finished),
        estimate=StudyEstimate(**row.estimate),
        study=document,
        links=links,
    )


def case_resource(row: Simulation, now: float) -> CaseResource:
    """The document of a case as part of its study, at a time."""
    number = row.study_number or 0
    return CaseResource(
        number=number,
        folder=folder_name(number),
        id=row.id,
        name=row.name,
        state=row.state,
        coordinates=row.coordinates or {},
        attempt=row.attempt,
        started_at=when_or_none(row.started),
        finished_at=when_or_none(row.finished),
        results=row.results,
        error=FailureResource(**row.error) if row.error else None,
        expires_at=when_or_none(row.expires_at),
        expired=row.is_expired(now),
        href=simulation_path(row.id),
    )
