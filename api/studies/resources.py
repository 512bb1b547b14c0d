"""Documents of studies, made from their rows."""

from __future__ import annotations

from typing import Any

from api.http.documents import PREFIX, when, when_or_none
from api.simulations.resources import simulation_path
from tomosim_contract.failure import FailureResource
from tomosim_contract.names import STATES
from tomosim_contract.studies import CaseResource, StudyEstimate, StudyResource
from worker.records.jobs import Simulation
from worker.records.studies import Study


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
