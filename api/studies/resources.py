"""The documents of studies from their rows."""

from __future__ import annotations

from typing import Any

from api.resources import PREFIX, FailureResource, simulation_path, when
from api.study_resources import CasePage as CasePage
from api.study_resources import CaseResource as CaseResource
from api.study_resources import StudyEstimate as StudyEstimate
from api.study_resources import StudyPage as StudyPage
from api.study_resources import StudyResource as StudyResource
from worker.contract import STATES
from worker.records.jobs import Simulation
from worker.records.retention import is_expired
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
        started_at=when(row.started) if row.started else None,
        finished_at=when(row.finished) if row.finished else None,
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
        started_at=when(row.started) if row.started else None,
        finished_at=when(row.finished) if row.finished else None,
        results=row.results,
        error=FailureResource(**row.error) if row.error else None,
        expires_at=when(row.expires_at) if row.expires_at else None,
        expired=is_expired(row, now),
        href=simulation_path(row.id),
    )
