"""Documents of cases, made from their rows."""

from __future__ import annotations

import time
from typing import Any

from api.http.documents import PREFIX, when, when_or_none
from simcore.needs import Estimate
from tomosim_contract.failure import FailureResource
from tomosim_contract.simulations import ProgressResource, SimulationResource, StudyPlace
from worker.records.jobs import Simulation


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
