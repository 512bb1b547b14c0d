"""Answers about studies."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from tomosim_contract.failure import FailureResource
from tomosim_contract.names import State, StudyState


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
