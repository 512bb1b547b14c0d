"""Answers about cases."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from simcore.needs import Estimate
from tomosim_contract.failure import FailureResource
from tomosim_contract.names import Queue, State


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
