"""Pins: the files of a case or of a study are kept until it is unpinned or deleted."""

from __future__ import annotations

from fastapi import APIRouter

from api.http.auth import Write
from api.http.deps import Identifier, Served, StudyIdentifier
from api.simulations.resources import simulation_resource
from api.studies.resources import study_resource
from tomosim_contract.simulations import SimulationResource
from tomosim_contract.studies import StudyResource

router = APIRouter(tags=["retention"])

_EXPIRED: dict[int | str, dict[str, str]] = {410: {"description": "expired"}}


@router.post("/simulations/{identifier}/pin", responses=_EXPIRED)
def pin(caller: Write, identifier: Identifier, served: Served) -> SimulationResource:
    """Keeps the files of a case until it is unpinned or deleted."""
    served.retention.pin(identifier)
    return simulation_resource(served.jobs.get(identifier))


@router.delete("/simulations/{identifier}/pin", responses=_EXPIRED)
def unpin(caller: Write, identifier: Identifier, served: Served) -> SimulationResource:
    """From now on the files are kept as long as if the case had just ended."""
    served.retention.unpin(identifier)
    return simulation_resource(served.jobs.get(identifier))


@router.post("/studies/{identifier}/pin", responses=_EXPIRED)
def pin_study(caller: Write, identifier: StudyIdentifier, served: Served) -> StudyResource:
    """Keeps the files of all cases of a study."""
    served.retention.pin_study(identifier)
    return study_resource(served.studies.get(identifier))


@router.delete("/studies/{identifier}/pin", responses=_EXPIRED)
def unpin_study(caller: Write, identifier: StudyIdentifier, served: Served) -> StudyResource:
    """From now on the files of its cases are kept as long as if it had just ended."""
    served.retention.unpin_study(identifier)
    return study_resource(served.studies.get(identifier))
